"""`g1stream learn`: a correction of the joint targets, from sessions of one motion."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from g1stream.cli.command import EXIT_OK, Command, print_json, print_lines
from g1stream.cli.flags import argument, flag
from g1stream.errors import ConfigError
from g1stream.files import check_output_path

if TYPE_CHECKING:
    from g1stream.motion.correction import Correction

__all__ = ["Learn"]

#: Joints that are named where a correction stays as it is.
_SHOWN = 3


@dataclass(frozen=True, kw_only=True)
class Learn(Command):
    """Corrects the joint targets by the error that repeats, for `stream --correction`.

    Give all sessions of the motion so far: it continues from the best one, and leaves alone what
    did not respond or does not repeat. They must agree in motion, rate, gains, support and
    feed-forward. Begin with two sessions or more where the simulator is slower than real time.

    Examples:
      g1stream stream dance.csv --record first.mcap
      g1stream learn first.mcap -o better.npz
      g1stream stream dance.csv --correction better.npz --record second.mcap
      g1stream learn first.mcap second.mcap -o better2.npz

    Exit codes:
      0  learned
      2  bad input: sessions that do not fit together, or cannot be learned from
    """

    sessions: tuple[Path, ...] = argument("Session files of one motion.", "SESSION...")
    out: Path = flag(MISSING, "The file to write.", "NPZ", aliases=("-o",))
    force: bool = flag(False, "Replace a file that exists already.")
    json: bool = flag(False, "Print what was learned as JSON.")

    def run(self) -> int:
        """Learn and write the file, and return the exit code."""
        from g1stream.analysis.learning import learn

        if not self.sessions:
            raise ConfigError(
                "Sessions to learn from are needed.",
                "Give them: g1stream learn SESSION... -o better.npz.",
            )
        check_output_path(self.out, force=self.force)
        correction = learn(self.sessions)
        correction.save(self.out, force=self.force)
        if self.json:
            print_json(_record(correction, self.out))
        else:
            print_lines(_text(correction, self.out))
        return EXIT_OK


def _record(correction: Correction, path: Path) -> dict[str, Any]:
    conditions = correction.conditions
    return {
        "path": str(path),
        "motion": conditions.motion,
        "rate_hz": conditions.rate,
        "feedforward": conditions.feedforward,
        "support": conditions.support,
        "start_s": float(correction.time[0]),
        "stop_s": float(correction.time[-1]),
        "rmse_history_rad": correction.history.tolist(),
        "largest_rad": correction.largest,
        "frozen_share": float(correction.frozen.mean()),
        "frozen_s": correction.frozen_seconds,
    }


def _text(correction: Correction, path: Path) -> str:
    conditions, history = correction.conditions, correction.history.tolist()
    lines = [
        f"{path}: for {conditions.motion}, {correction.time[0]:.2f} to "
        f"{correction.time[-1]:.2f} s, {conditions.rate:g} Hz, "
        f"feed-forward {conditions.feedforward}, support {conditions.support or 'unknown'}",
        f"  RMSE so far     {', '.join(f'{rmse:.4f}' for rmse in history)} rad",
        f"  correction      {correction.largest:.4f} rad at most",
    ]
    frozen = [f"{joint} {s:.1f} s" for joint, s in correction.frozen_seconds.items()]
    if frozen:
        more = f", {len(frozen) - _SHOWN} more" if len(frozen) > _SHOWN else ""
        lines.append(f"  did not respond {', '.join(frozen[:_SHOWN])}{more}: stays as it is there")
    return "\n".join(lines)
