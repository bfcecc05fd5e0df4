"""The Python types against idl/, the source of truth for the wire."""

from cyclonedds.idl import types as cyclone_types

from g1stream.dds.layout import leaves, members
from g1stream.dds.messages import TOPICS

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


def test_idl_and_python_declare_the_same_types(declared, our_types):
    fixed = [name for name in declared if not name.startswith("unitree_api.")]
    assert [t.__idl_typename__ for t in our_types] == sorted(fixed)


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


def test_types_are_final_and_numbered_in_order(declared, idl_type):
    assert declared[idl_type.__idl_typename__].annotations == ["@final"]
    assert idl_type.__idl_annotations__ == {"extensibility": "final", "autoid": "sequential"}


def test_class_is_named_like_its_type(idl_type):
    assert idl_type.__name__ == idl_type.__idl_typename__.rpartition(".")[2]


def test_leaves_are_the_primitives_in_order(declared, idl_type):
    def walk(name):
        module = name.rpartition(".")[0]
        for field, (element, length) in declared[name].fields.items():
            for i in range(length or 1):
                index = () if length is None else (i,)
                if element in PRIMITIVES:
                    yield field, index
                else:
                    for path, inner in walk(f"{module}.{element}"):
                        yield f"{field}.{path}", index + inner

    found = [(leaf.path, leaf.index) for leaf in leaves(idl_type)]
    assert found == list(walk(idl_type.__idl_typename__))


def test_every_topic_has_a_name_and_a_type_of_its_own(declared):
    names = [topic.name for topic in TOPICS]
    assert len(set(names)) == len(names)
    assert all(name.startswith("rt/") for name in names)
    assert all(topic.message.idl_type.__idl_typename__ in declared for topic in TOPICS)
