"""The page of a report: its sections, and with them the script that draws the figures."""

from __future__ import annotations

import base64
import csv
import gzip
import io
import json
import os
from datetime import datetime, timezone
from html import escape
from importlib import resources
from mimetypes import guess_type
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, Final, cast

from g1stream._version import __version__
from g1stream.analysis.layouts import short_name
from g1stream.analysis.render import session_facts, stream_facts, verdict
from g1stream.analysis.report.figures import figures
from g1stream.analysis.report.tables import overview, tables
from g1stream.errors import ConfigError
from g1stream.files import complete_file, read_file
from g1stream.robot.joints import JOINT_GROUPS, JOINT_NAMES
from g1stream.session.session import Session, open_session
from g1stream.text import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from typing import TypeAlias

    from g1stream.session.metrics import Metrics
    from g1stream.session.summary import Summary

    Given: TypeAlias = Session | str | os.PathLike[str]

__all__ = ["numbers", "report", "to_csv"]

#: A video or picture beside a session, of the same name, is shown; the first of these.
_PICTURES: Final = (".mp4", ".gif", ".png")
_LARGEST_PICTURE: Final = 50 * 2**20


def report(
    sessions: Given | Iterable[Given], path: str | os.PathLike[str], *, force: bool = False
) -> Path:
    """Write the report of one session or several: an HTML page that needs no network.

    A video or a picture beside a session file, of the same name, is shown in it.

    Args:
        sessions: sessions, or their paths.
        path: of the page.
        force: replace a file that is there.

    Raises:
        ConfigError: there are no sessions.
        RecordingError: a session is damaged, or the page cannot be written.
    """
    with complete_file(Path(path), force=force) as temporary:
        temporary.write_text(_page(_opened(sessions)), encoding="utf-8")
    return Path(path)


def numbers(sessions: Given | Iterable[Given]) -> dict[str, Any]:
    """The numbers of a report, as values for JSON: summary and metrics of each session."""
    return {
        "sessions": [
            _values(session, session.metrics(), session.summary()) for session in _opened(sessions)
        ]
    }


def to_csv(values: Mapping[str, Any]) -> str:
    """The metrics among the numbers of a report as CSV: a row for each, by session and key."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(("session", "key", "value"))
    for one in values["sessions"]:
        rows.writerows((one["path"], key, value) for key, value in _flat(one["metrics"]))
    return text.getvalue()


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif value is not None:
            yield prefix + key, value


def _opened(sessions: Given | Iterable[Given]) -> Iterator[Session]:
    """One session after the other, so that no more than one has to be in memory."""
    alone = isinstance(sessions, (Session, str, os.PathLike))
    given = list(cast("Iterable[Given]", [sessions] if alone else sessions))
    if not given:
        raise ConfigError("There is no session to report on.", "Name a session file.")
    for one in given:
        yield one if isinstance(one, Session) else open_session(one)


def _values(session: Session, metrics: Metrics, summary: Summary) -> dict[str, Any]:
    return {
        "path": str(session.path),
        "verdict": verdict(summary),
        "summary": summary.model_dump(mode="json"),
        "metrics": metrics.model_dump(mode="json"),
    }


def _page(sessions: Iterable[Session]) -> str:
    from plotly.offline import get_plotlyjs

    values, sections, drawn = [], [], []
    for number, session in enumerate(sessions):
        # The metrics read all columns that are needed, the summary alone only some.
        metrics, summary = session.metrics(), session.summary()
        values.append(_values(session, metrics, summary))
        drawn.append(figures(session, summary, metrics))
        sections.append(_section(number, session, summary, values[-1]["metrics"], drawn[-1]))
    one = len(values) == 1
    return Template(_resource("page.html")).substitute(
        title=_text(Path(values[0]["path"]).name) if one else f"{len(values)} sessions",
        made=_text(f"g1stream {__version__}, {datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC"),
        style=_resource("report.css"),
        overview="" if one else overview(values),
        sections="\n".join(sections),
        plotly=_packed(get_plotlyjs()),
        figures=_packed(json.dumps(drawn)),
        script=_resource("report.js"),
    )


def _section(
    number: int,
    session: Session,
    summary: Summary,
    metrics: Mapping[str, Any],
    drawn: Mapping[str, Any],
) -> str:
    parts = tables(metrics, f"sessions.{number}.metrics")
    for name in ("joints", "torques"):
        parts[name] = _details("Each joint", parts[name])
    for name in ("tracking", "body", "torque"):
        reason = metrics["missing"].get(name)
        parts[f"missing_{name}"] = f'<p class="missing">{_text(reason)}</p>' if reason else ""
    parts["missing_timing"] = "" if parts["topics"] else '<p class="missing">No topic of DDS.</p>'
    if any(one["lines"] for one in drawn["signals"].values()):
        parts["joint"] = _figure(
            number, "joint", f"Joint {_joint_choice(drawn['first_joint'], summary.absent)}"
        )
    for name, caption in (
        ("limbs", "RMS error of each limb over time, and events of the log"),
        ("rmse_deg", "RMSE of each joint; a click shows it above"),
        ("lateness", "How late commands were written"),
        ("intervals", "Intervals between publish times: a stall is a peak"),
    ):
        parts[f"{name}_figure"] = _figure(number, name, caption) if drawn[name] else ""
    facts = session_facts(summary)
    if summary.versions:
        facts.append(("versions", ", ".join(map(" ".join, summary.versions.items()))))
    return Template(_resource("session.html")).substitute(
        {"joint": "", **parts},
        number=number,
        name=_text(session.path.name),
        verdict=_text(verdict(summary)),
        good="bad" if summary.problems else "good",
        problems="".join(f'<p class="problem">{_text(text)}</p>' for text in summary.problems),
        picture=_picture(session),
        facts=_facts(facts),
        stream=_facts(stream_facts(summary.stream) if summary.stream else []),
        events=_events(drawn["events"]),
    )


def _figure(number: int, name: str, caption: str) -> str:
    return (
        f"<figure><figcaption>{caption}</figcaption>"
        f'<div data-figure="{name}" data-session="{number}"></div></figure>'
    )


def _joint_choice(first: int, absent: Sequence[str]) -> str:
    groups = "".join(
        f'<optgroup label="{limb.replace("_", " ")}">'
        + "".join(
            f'<option value="{joint}"{" selected" * (joint == first)}>'
            f"{short_name(JOINT_NAMES[joint])}</option>"
            for joint in joints
            if JOINT_NAMES[joint] not in absent
        )
        + "</optgroup>"
        for limb, joints in JOINT_GROUPS.items()
        if any(JOINT_NAMES[joint] not in absent for joint in joints)
    )
    return f'<select aria-label="joint">{groups}</select>'


def _facts(facts: Sequence[tuple[str, str]]) -> str:
    rows = "".join(f"<dt>{_text(label)}</dt><dd>{_text(text)}</dd>\n" for label, text in facts)
    return f"<dl>\n{rows}</dl>" if facts else ""


def _events(events: Sequence[Mapping[str, Any]]) -> str:
    if not events:
        return '<p class="missing">The log has no events.</p>'
    rows = "".join(
        f'<tr><td>{one["time"]:.3f}</td><td class="text level">{_text(one["level"])}</td>'
        f'<td class="text">{_text(one["text"])}</td></tr>\n'
        for one in events
    )
    return _details(
        f"{len(events)} in the log",
        '<div class="wide"><table class="events"><thead><tr><th>time<small>s</small></th>'
        '<th class="text">level</th><th class="text">event</th></tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>",
    )


def _details(summary: str, content: str) -> str:
    return f"<details><summary>{summary}</summary>{content}</details>" if content else ""


def _picture(session: Session) -> str:
    """The video or picture beside a session file; none beside a session in memory."""
    paths = [session.path.with_suffix(suffix) for suffix in _PICTURES] if session.paths else []
    path = next(filter(Path.is_file, paths), None)
    if path is None:
        return ""
    try:
        data = base64.b64encode(read_file(path, _LARGEST_PICTURE)).decode()
    except OSError as error:
        return f'<p class="missing">{_text(f"{path.name} is not shown: {error.strerror}.")}</p>'
    kind = guess_type(path.name)[0] or ""
    if kind.startswith("video/"):
        return f'<video controls muted loop playsinline src="data:{kind};base64,{data}"></video>'
    return (
        f'<img class="picture" alt="the robot and its reference" src="data:{kind};base64,{data}">'
    )


def _text(text: str) -> str:
    """What may come from a file or a peer, as HTML."""
    return escape(printable(text))


def _packed(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), 6, mtime=0)).decode()


def _resource(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
