import pytest
from cyclonedds.idl import types as cyclone_types

from g1stream.dds import types
from g1stream.dds.layout import members

# Beyond cyclonedds 0.10 IDL's octet is `byte` there: `uint8` would crash peers (see types.py).
PRIMITIVES = {
    "octet": "byte" if hasattr(cyclone_types, "byte") else "uint8",
    "short": "int16",
    "long": "int32",
    "unsigned long": "uint32",
    "unsigned long long": "uint64",
    "float": "float32",
    "double": "float64",
}


def all_types():
    """Every cyclonedds class of ours with a fixed size, those inside others included."""
    found = {}
    pending = [getattr(types, name) for name in types.__all__]
    while pending:
        idl_type = pending.pop()
        found[idl_type.__idl_typename__] = idl_type
        pending += [one for one, _ in members(idl_type).values() if not isinstance(one, str)]
    return [found[name] for name in sorted(found)]


each_type = pytest.mark.parametrize("idl_type", all_types(), ids=lambda t: t.__idl_typename__)


def test_idl_and_python_declare_the_same_types(declared):
    fixed = [name for name in declared if not name.startswith("unitree_api.")]
    assert [t.__idl_typename__ for t in all_types()] == sorted(fixed)


@each_type
def test_fields_are_those_of_the_idl(declared, idl_type):
    name = idl_type.__idl_typename__
    module = name.rpartition(".")[0]
    expected = [
        (field, PRIMITIVES.get(element) or f"{module}.{element}", length)
        for field, (element, length) in declared[name].fields.items()
    ]
    ours = [
        (field, element if isinstance(element, str) else element.__idl_typename__, length)
        for field, (element, length) in members(idl_type).items()
    ]
    assert ours == expected


@each_type
def test_types_are_final_and_numbered_in_order(declared, idl_type):
    assert declared[idl_type.__idl_typename__].annotations == ["@final"]
    assert idl_type.__idl_annotations__ == {"extensibility": "final", "autoid": "sequential"}
