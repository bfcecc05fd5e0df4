"""Raw samples of the wire, a batch at a time, seen as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from g1stream.dds.layout import CDR_HEADER, Layout
from g1stream.robot.joints import N_JOINTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from g1stream.dds.topics import Topic

__all__ = ["Batch", "Samples"]


@dataclass
class Batch:
    """Samples of one topic, oldest first.

    Attributes:
        data: each sample as it is on the wire, CDR header included.
        log_times: when each was received here, CLOCK_REALTIME, ns.
        publish_times: when its writer says it was published, ns.
        writers: by which writer; Cyclone's handle of it.
    """

    data: list[bytes] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    publish_times: list[int] = field(default_factory=list)
    writers: list[int] = field(default_factory=list)


class Samples:
    """A batch of samples of one topic; `samples["imu_state.gyroscope"]` is one array of all.

    The wire's arrays of 35 motors are shown up to the last that a G1 has.

    Args:
        topic: whose samples they are.
        data: (N) samples as they were on the wire, CDR header included.

    Raises:
        ValueError: a sample is not one of this topic's type in plain little-endian CDR.
    """

    def __init__(self, topic: Topic, data: Sequence[bytes]) -> None:
        self._layout = Layout.of(topic.message.idl_type)
        size = self._layout.sample_size
        odd = next((d for d in data if len(d) != size or d[:2] != CDR_HEADER[:2]), None)
        if odd is not None:
            raise ValueError(
                f"a sample has {len(odd)} bytes, encoding 0x{odd[:2].hex()}, where "
                f"{self._layout.typename} has {size}, encoding 0x{CDR_HEADER[:2].hex()}"
            )
        rows = np.frombuffer(b"".join(data), dtype=np.uint8).reshape(len(data), size)
        self._payloads = rows[:, len(CDR_HEADER) : len(CDR_HEADER) + self._layout.size]

    def __getitem__(self, path: str) -> NDArray[Any]:
        """(N, ...) a field by its dotted path in the IDL, in the wire's own precision; a copy."""
        values = self._layout[path].read(self._payloads)
        return values[:, :N_JOINTS] if path.startswith(("motor_cmd.", "motor_state.")) else values
