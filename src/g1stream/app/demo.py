"""Run the bridge, a stream, a recorder and a figure on one machine."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from g1stream.analysis.summary import Summary
from g1stream.app.stream import stream
from g1stream.child_process import Child
from g1stream.config import Config
from g1stream.control.loop import StreamLoop
from g1stream.dds.domain import DISCOVERY, Participant
from g1stream.dds.messages import LOWSTATE
from g1stream.errors import ConfigError, RecordingError, WireError
from g1stream.files import output_errors
from g1stream.motion.motion import Motion
from g1stream.network import is_local_only, is_loopback

_LOGGER = logging.getLogger(__name__)

SESSION, FIGURE = "session.mcap", "tracking.png"
"""Names of the files in the output directory."""

#: Number of domains to try, starting at the default.
_MOST_DOMAINS: Final = 8


def demo(
    motion: Motion | str | Path,
    out: Path,
    config: Config | None = None,
    *,
    force: bool = False,
    on_loop: Callable[[StreamLoop, Config], None] | None = None,
) -> Summary:
    """Play a motion on the simulated robot and record it, on this machine only.

    It returns the summary of the session, or the stream's summary if no command was sent.
    """
    from g1stream.analysis.plots import draw
    from g1stream.app.session import open_session

    config = config or Config()
    if config.stream.policy or "feet" in (config.sim.support, config.stream.support):
        config = _on_its_feet(config)
    _check_local_only(config.dds.interface)
    session_path, figure_path = out / SESSION, out / FIGURE
    if not force:
        check_absent(session_path, figure_path)
    config = _with_free_domain(config)
    made = not out.exists()
    with output_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    # The stream publishes for ROS 2, so nothing else does.
    sim = Child("sim", config.changed(dds={"ros_tf": False}))
    try:
        sim.wait_until_ready()
        played = stream(
            motion,
            config,
            record=session_path,
            force=force,
            on_loop=on_loop and (lambda loop: on_loop(loop, config)),
        )
        sim.finish()
    finally:
        sim.kill()
        if made:
            with suppress(OSError):  # something is in it
                out.rmdir()
    recorder = played.recorder
    if not (played.stream and played.stream.commands and recorder) or recorder.removed:
        return played
    session = open_session(recorder.path)
    draw(session, figure_path)
    return session.summary()


def _on_its_feet(config: Config) -> Config:
    """The config for an unsupported robot that a policy or the stream balances."""
    given = "support" in config.sim.model_fields_set
    if given and config.sim.held_by != "free":
        raise ConfigError(
            f"The robot stands on its own feet, but sim.support is {config.sim.support}.",
            "Give --support feet, or remove --support.",
        )
    balanced = config.stream.support if config.stream.policy else "feet"
    return config.changed(sim={"support": "free"}, stream={"support": balanced})


def _check_local_only(interface: str) -> None:
    if is_local_only(interface):
        return
    what = "CYCLONEDDS_URI is set, which may select another network"
    if not is_loopback(interface):
        what = f"the interface {interface} is not the loopback"
    raise ConfigError(
        f"A demo is local to this machine, but {what}.",
        "Remove that setting; to play on a robot use `g1stream stream`.",
    )


def check_absent(*paths: Path) -> None:
    """Refuse to replace existing files."""
    for path in paths:
        if path.exists():
            raise RecordingError(
                f"The file {path} exists already.",
                "Give --force to replace it, or choose another --out.",
            )


def _with_free_domain(config: Config) -> Config:
    """The config with a domain without publishers on the robot's topics."""
    first = config.dds.domain
    given = "domain" in config.dds.model_fields_set
    for domain in range(first, first + (1 if given else _MOST_DOMAINS)):
        others = _publishers(domain, config.dds.interface)
        if not others:
            return config.changed(dds={"domain": domain})
        _LOGGER.info("DDS domain %d is in use by %s", domain, ", ".join(others))
    raise WireError(
        f"DDS domain {domain} has other publishers: {', '.join(others)}.",
        f"Stop them, or choose a free domain, such as --domain {domain + 1}.",
    )


def _publishers(domain: int, interface: str) -> list[str]:
    """The publishers on topics of the robot or the streamer."""
    with Participant(domain, interface) as participant:
        time.sleep(DISCOVERY)
        writers = [*participant.writers(LOWSTATE.name), *participant.commanders()]
        return sorted({participant.owner(writer) for writer in writers})
