"""What a session file is made of: MB by channel, for each set of channels.

    python benchmarks/file_size.py [MOTION] [--seconds S] [--json]

The motion, by default the bundled demo, is played on the simulated robot in lockstep (`rollout`),
and saved with each value of `record.channels`. A channel's MB are those of its chunks in the file,
compressed, with their message indexes.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, get_args

from mcap.reader import make_reader

from g1stream.app.rollout import rollout
from g1stream.config import Config
from g1stream.types import ChannelSet


def sizes(path: Path) -> dict[str, float]:
    """MB by topic, `rest of the file` included."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary
    found: Counter[str] = Counter()
    for chunk in summary.chunk_indexes:
        (channel,) = chunk.message_index_offsets  # a chunk has the messages of one topic
        found[summary.channels[channel].topic] += chunk.chunk_length + chunk.message_index_length
    found["rest of the file"] = path.stat().st_size - found.total()
    return {topic: size / 1e6 for topic, size in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("motion", nargs="?", default="demo")
    parser.add_argument("--seconds", type=float, help="how much of the motion")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    by_set: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as directory:
        for channels in get_args(ChannelSet):
            config = Config.model_validate({"record": {"channels": channels}})
            path = Path(directory, f"{channels}.mcap")
            rollout(args.motion, config=config, seconds=args.seconds).save(path)
            by_set[channels] = sizes(path)
    if args.json:
        print(json.dumps(by_set))
        return
    print(table(by_set))


def table(by_set: dict[str, dict[str, Any]]) -> str:
    """The sizes as Markdown, the largest channel first."""
    largest = list(by_set.values())[-1]
    topics = sorted(largest, key=lambda topic: -largest[topic])
    rows = [["MB", *by_set], ["---"] * (1 + len(by_set))]
    rows += [[t, *(f"{s[t]:.2f}" if t in s else "-" for s in by_set.values())] for t in topics]
    rows.append(["all", *(f"{sum(s.values()):.1f}" for s in by_set.values())])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


if __name__ == "__main__":
    main()
