"""The floor of a conversion: the stock writer writes messages that are encoded already.

    python convert_floor.py MESSAGES OUT.mcap

MESSAGES is a pickle of schemas, channels and messages, as convert.py makes it. Prints how long
reading it and writing the MCAP took, s, without the start of Python.
"""

from __future__ import annotations

import pickle
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.writer import Writer

if TYPE_CHECKING:
    from typing import Any


def main(messages: str, out: str) -> None:
    start = time.perf_counter()
    with Path(messages).open("rb") as file:
        channels, rows = pickle.load(file)
    with Path(out).open("wb") as file:
        writer: Any = Writer(file)
        writer.start()
        ids = {}
        for topic, schema_name, schema_encoding, message_encoding, schema in channels:
            schema_id = writer.register_schema(schema_name, schema_encoding, schema)
            ids[topic] = writer.register_channel(topic, message_encoding, schema_id)
        for topic, stamp, data in rows:
            writer.add_message(ids[topic], stamp, data, stamp)
        writer.finish()
    print(time.perf_counter() - start)


if __name__ == "__main__":
    main(*sys.argv[1:])
