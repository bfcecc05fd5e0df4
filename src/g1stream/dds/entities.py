"""Cyclone's writer and reader with the counts that the Python classes of 0.10.2 do not show.

They could be had from listeners too, but a listener is called from Cyclone's own thread, and one
that waits for the interpreter while the interpreter deletes the entity waits for ever.
"""

# The decorator reads the annotations when the class is made, so they must not be postponed here.
import ctypes
from typing import Any

from cyclonedds.internal import c_call, dds_c_t
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader

__all__ = ["CountingReader", "CountingWriter"]


class CountingWriter(DataWriter[Any]):  # type: ignore[misc]
    """Adds the count of matched readers, which 0.10.2's own class does not show."""

    def matched(self) -> int:
        """How many peers are matched."""
        status = dds_c_t.publication_matched_status()
        self._matched_status(self._ref, ctypes.byref(status))
        return int(status.current_count)

    @c_call("dds_get_publication_matched_status")  # type: ignore[untyped-decorator]
    def _matched_status(
        self,
        writer: dds_c_t.entity,
        status: ctypes.POINTER(dds_c_t.publication_matched_status),  # type: ignore[valid-type]
    ) -> dds_c_t.returnv: ...


class CountingReader(DataReader[Any]):  # type: ignore[misc]
    """Adds the counts of matched writers and of lost samples, which 0.10.2's own does not show."""

    def matched(self) -> int:
        """How many peers are matched."""
        status = dds_c_t.subscription_matched_status()
        self._matched_status(self._ref, ctypes.byref(status))
        return int(status.current_count)

    def lost(self) -> int:
        """How many samples the reader knows that it missed."""
        status = dds_c_t.sample_lost_status()
        self._lost_status(self._ref, ctypes.byref(status))
        return int(status.total_count)

    @c_call("dds_get_subscription_matched_status")  # type: ignore[untyped-decorator]
    def _matched_status(
        self,
        reader: dds_c_t.entity,
        status: ctypes.POINTER(dds_c_t.subscription_matched_status),  # type: ignore[valid-type]
    ) -> dds_c_t.returnv: ...

    @c_call("dds_get_sample_lost_status")  # type: ignore[untyped-decorator]
    def _lost_status(
        self,
        reader: dds_c_t.entity,
        status: ctypes.POINTER(dds_c_t.sample_lost_status),  # type: ignore[valid-type]
    ) -> dds_c_t.returnv: ...
