"""`g1stream robot`: shows, releases or restores the robot's own controller."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal

from g1stream.cli.command import EXIT_OK, SettingsCommand, confirmed, print_result, yes_flag
from g1stream.cli.flags import argument, flag
from g1stream.errors import ConfigError, SafetyError
from g1stream.events import ConsoleHandler, handled_by

if TYPE_CHECKING:
    from g1stream.config import Config

Action = Literal["status", "release", "restore"]


@dataclass(frozen=True, kw_only=True)
class Robot(SettingsCommand):
    """Talks to the motion service (MotionSwitcher), which runs the robot's own controller.

    That controller also publishes rt/lowcmd, so it must be released before a motion is streamed.

    `status` prints form and active mode. `release` ends the mode and prints how to restore it.
    The robot goes limp, so support it first. `restore` starts MODE.

    On any interface but loopback you must confirm, on the terminal or with --yes INTERFACE.

    Examples:
      g1stream robot status --config robot --interface eth0
      g1stream robot release --config robot --interface eth0
      g1stream robot restore ai --config robot --interface eth0
      g1stream sim --onboard ai             # a simulated robot to try it on

    Exit codes:
      0  success
      2  bad input, not confirmed, no motion service, or the service refused
    """

    action: Action = argument("What to do.", "ACTION")
    mode: str | None = flag(
        None,
        "Mode to restore, such as ai.",
        "MODE",
        positional=True,
        needs=("action=restore",),
    )
    timeout: float = flag(5.0, "Longest wait for an answer, including discovery.", "SECONDS", gt=0)
    yes: str | None = yes_flag("action=release", "action=restore")
    json: bool = flag(False, "Print the result as JSON on standard output.")

    def run(self) -> int:
        """Do the action, and return the exit code."""
        config = self.resolve()
        if self.action == "restore" and not self.mode:
            raise ConfigError("The mode to restore is missing.", "Give one, such as ai.")
        with handled_by(ConsoleHandler()):
            if self.action == "status":
                return self._status(config)
            return self._change(config)

    def _status(self, config: Config) -> int:
        from g1stream.extras.onboard.motion_service import onboard_status

        status = onboard_status(config.dds, self.timeout)
        print_result(asdict(status), f"active mode: {status.name or 'none'}", as_json=self.json)
        return EXIT_OK

    def _change(self, config: Config) -> int:
        from g1stream.extras.onboard.motion_service import release_mode, restore_mode
        from g1stream.network import is_local_only, network_name

        if not is_local_only(config.dds.interface):
            what = (
                "goes limp" if self.action == "release" else "will be moved by its own controller"
            )
            print(f"WARNING: the robot {what}. Support it first.", file=sys.stderr)
            if not confirmed(network_name(config.dds.interface), self.yes):
                raise SafetyError(
                    "The action was not confirmed; nothing was done.",
                    "Run it again, and type the name of the interface.",
                )
        if self.mode:
            restore_mode(config.dds, self.mode, self.timeout)
            about, text = {"active": self.mode}, f"mode {self.mode} is active"
        else:
            released = release_mode(config.dds, self.timeout)
            how = f"is released; restore it with: g1stream robot restore {released}"
            text = f"mode {released} {how}" if released else "no mode is active: nothing to release"
            about = {"released": released}
        print_result(about, text, as_json=self.json)
        return EXIT_OK
