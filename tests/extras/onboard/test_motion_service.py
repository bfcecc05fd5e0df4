import dataclasses
import json
from contextlib import contextmanager
from typing import get_args, get_type_hints

import pytest

from g1stream.dds.domain import Participant
from g1stream.errors import WireError
from g1stream.extras.onboard.motion_service import (
    ApiEndpoint,
    ApiId,
    ErrorCode,
    MotionSwitcherClient,
    OnboardStatus,
    Request_,
    Response_,
    response_to,
)
from threads import in_thread

IDL_NAMES = {
    str: "string",
    bool: "boolean",
    "int32": "long",
    "int64": "long long",
    "byte": "octet",
    "uint8": "octet",  # on cyclonedds 0.10
}


def idl_name(hint):
    mark = hint if hint in IDL_NAMES else (get_args(hint)[1:] or (hint,))[0]
    if hasattr(mark, "subtype"):
        return f"sequence<{idl_name(mark.subtype)}>"
    return IDL_NAMES.get(mark) or mark.__idl_typename__.rpartition(".")[2]


def structs(idl_type):
    """A type and those in it, by name, with the IDL name of each field's type."""
    hints = get_type_hints(idl_type, include_extras=True)
    found = {idl_type.__idl_typename__: {name: idl_name(hint) for name, hint in hints.items()}}
    for hint in hints.values():
        if hasattr(hint, "__idl_typename__"):
            found |= structs(hint)
    return found


def test_types_are_those_of_the_idl(declared):
    expected = {
        name: {field: element for field, (element, _) in struct.fields.items()}
        for name, struct in declared.items()
        if name.startswith("unitree_api.")
    }
    assert structs(Request_) | structs(Response_) == expected


@pytest.mark.parametrize(
    ("idl_type", "name"), [(Request_, "api_request"), (Response_, "api_response")]
)
def test_bytes_are_the_sdks(idl_type, name, golden):
    (sample,) = golden[name]
    data = bytes.fromhex(sample["cdr"])
    decoded = idl_type.deserialize(data)
    assert decoded.serialize() == data
    fields = dataclasses.asdict(decoded)
    assert {**fields, "binary": list(fields["binary"])} == {
        key: value for key, value in sample.items() if key != "cdr"
    }


@contextmanager
def service(domain_id, answer):
    """A service in a thread that answers with `answer(api id, parameter)`: code, data or None.

    Before each answer it gives one to somebody else's request.
    """
    calls = []
    with Participant(domain_id, "lo") as participant:
        endpoint = ApiEndpoint(participant, serves=True)

        def serve(stop):
            while not stop.wait(0.002):
                for request in endpoint.take():
                    identity = request.header.identity
                    calls.append((identity.api_id, json.loads(request.parameter)))
                    given = answer(*calls[-1])
                    if given:
                        other = response_to(request, *status("other"))
                        other.header.identity = type(identity)(id=1, api_id=identity.api_id)
                        endpoint.write(other)
                        endpoint.write(response_to(request, *given))

        with in_thread(serve):
            yield calls


def status(name="ai", form="0"):
    return ErrorCode.DONE, json.dumps({"form": form, "name": name})


def test_release_and_select_are_sent_once_and_waited_for(domain_id):
    active = ["ai"]

    def answer(api, parameter):
        if api == ApiId.CHECK_MODE:
            return status(active[0], "1")
        active[0] = parameter.get("name", "")
        return ErrorCode.DONE, ""

    with service(domain_id, answer) as calls, Participant(domain_id, "lo") as ours:
        client = MotionSwitcherClient(ours)
        assert client.check() == OnboardStatus(form="1", name="ai")
        client.release()
        assert active == [""]
        client.select("advanced")
        assert active == ["advanced"]
    changes = [call for call in calls if call[0] != ApiId.CHECK_MODE]
    assert changes == [(ApiId.RELEASE_MODE, {}), (ApiId.SELECT_MODE, {"name": "advanced"})]


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ((ErrorCode.BUSY, ""), "7002"),
        ((ErrorCode.DONE, "no JSON"), "no JSON"),
        ((ErrorCode.DONE, "[1]"), "[1]"),
        ((ErrorCode.DONE, '{"form": "0"}'), "form"),
        (None, "CheckMode"),
    ],
)
def test_an_answer_that_is_no_status_is_an_error(given, named, domain_id):
    with service(domain_id, lambda *_: given), Participant(domain_id, "lo") as ours:
        client = MotionSwitcherClient(ours, timeout=1.0)
        with pytest.raises(WireError) as caught:
            client.check()
    assert named in caught.value.cause


def test_a_mode_that_stays_active_is_an_error(domain_id):
    with (
        service(domain_id, lambda *_: status("ai")),
        Participant(domain_id, "lo") as ours,
        pytest.raises(WireError) as caught,
    ):
        MotionSwitcherClient(ours, timeout=1.0).release()
    assert "ai" in caught.value.cause


def test_no_service_is_told_from_one_that_does_not_answer(domain_id):
    with Participant(domain_id, "lo") as ours, pytest.raises(WireError) as caught:
        MotionSwitcherClient(ours, timeout=0.3).check()
    assert "no subscriber" in caught.value.cause
