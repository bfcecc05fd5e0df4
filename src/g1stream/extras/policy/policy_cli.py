"""`g1stream policy`: shows the inputs and outputs of a policy, and checks them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from g1stream.cli.command import (
    EXIT_OK,
    EXIT_STOPPED,
    Command,
    print_json,
    print_lines,
    print_note,
    print_result,
    print_warning,
)
from g1stream.cli.flags import flag
from g1stream.errors import ConfigError

if TYPE_CHECKING:
    from g1stream.extras.policy.contract import PolicyContract
    from g1stream.extras.policy.golden import GoldenRun
    from g1stream.extras.policy.network import Network
    from g1stream.extras.policy.rehearsal import Rehearsal
    from g1stream.extras.policy.replay import PolicyReplay
    from g1stream.motion.motion import Motion


@dataclass(frozen=True, kw_only=True)
class Policy(Command):
    """Prints the contract of a learned policy: observation, joints, gains, rate, reference.

    A policy is an ONNX file, or the name of a published one, such as holosoma, which is downloaded
    once. Facts that its metadata lacks are read from deploy.yaml or from a TOML
    file of the same name beside it. Facts that no file has are listed with the line to write.

    --motion plays the first five seconds in lockstep, standing included. If the robot falls, some
    twenty contracts that differ by one common mistake are tried, and those that stand are named.

    --golden compares a run of the training side, term by term: a file of numpy.savez with a row for
    each step in joint_pos, joint_vel (N, joints), root_pos_w (N, 3), root_quat_w (N, 4) wxyz,
    root_lin_vel_b, root_ang_vel_b (N, 3), obs (N, width) and action (N, joints). It may have
    time_step (N,), the frame of the motion.

    --replay feeds the recorded observations to the policy and checks that it gives the recorded
    actions, bit for bit. It also compares observations recomputed from LowState and Reference with
    the recorded ones, term by term, and targets, gains and torques that were sent with those of the
    policy.

    Examples:
      g1stream policy holosoma
      g1stream policy policy.onnx
      g1stream policy policy.onnx --motion dance.csv
      g1stream policy policy.onnx --motion dance.csv --golden run.npz
      g1stream policy holosoma --toml > policy.toml
      g1stream policy --replay session.mcap

    Exit codes:
      0  printed
      1  printed, but the robot falls, or a golden run or a replay differs
      2  a fact is missing or wrong, no policy for a G1, or no policy in the session
    """

    file: str | None = flag(
        None,
        "ONNX file of the policy, or name of a published one; default: the recorded one.",
        "FILE",
        positional=True,
    )
    motion: str | None = flag(
        None,
        "Motion to track: its beginning is played in the simulator, unless --golden is given. A "
        "policy that holds one is a motion file, too.",
        "MOTION",
        excludes=("replay",),
    )
    golden: str | None = flag(
        None, "Run of the training side to compare with.", "NPZ", excludes=("replay",)
    )
    replay: str | None = flag(None, "Session whose observations the policy gets.", "SESSION")
    json: bool = flag(False, "Print the result as JSON.")
    toml: bool = flag(
        False,
        "Print the facts as TOML, to write them beside another policy.",
        excludes=("json", "motion", "golden", "replay"),
    )

    def run(self) -> int:
        """Print the contract and the verdicts, or a replay, and return the exit code."""
        if self.replay:
            return self._replay(self.replay)
        if self.file is None:
            from g1stream.extras.policy.published import published

            raise ConfigError(
                "No policy is given.",
                f"Give an ONNX file, or one of {', '.join(published())}, or --replay a session.",
            )
        return self._show(self.file)

    def _replay(self, path: str) -> int:
        from g1stream.app.session import open_session
        from g1stream.extras.policy.replay import replay_policy

        return self._compared(replay_policy(open_session(path), self.file))

    def _show(self, file: str) -> int:
        from g1stream.extras.policy.contract import read_contract
        from g1stream.extras.policy.network import Network
        from g1stream.motion.readers import load_motion
        from g1stream.robot.model import G1

        network = Network(file)
        contract = read_contract(network)
        if self.toml:
            print_lines(contract.toml())
            return EXIT_OK
        doubts = contract.doubts(G1.default())
        print_warning(*doubts)
        if not self.json:
            print_lines(str(contract))
        motion = None
        if self.motion:
            motion = load_motion(network.path if self.motion == file else self.motion)
            print_warning(*motion.warnings)
        if self.golden:
            from g1stream.extras.policy.golden import compare_golden

            return self._compared(compare_golden(Path(self.golden), network, contract, motion))
        found = self._rehearse(network, contract, motion) if motion else None
        if self.json:
            told: dict[str, Any] = {"doubts": doubts, "rehearsal": None}
            if found:
                verdict = {"stands": found.stands, "doubts": found.doubts}
                told["rehearsal"] = found.model_dump(mode="json") | verdict
            print_json(contract.model_dump(mode="json") | told)
        return EXIT_STOPPED if found and not found.stands else EXIT_OK

    def _compared(self, found: GoldenRun | PolicyReplay) -> int:
        about = found.model_dump(mode="json") | {"same": found.same}
        print_result(about, str(found), as_json=self.json)
        return EXIT_OK if found.same else EXIT_STOPPED

    def _rehearse(self, network: Network, contract: PolicyContract, motion: Motion) -> Rehearsal:
        from g1stream.extras.policy.rehearsal import Trial, rehearse_policy

        def said(trial: Trial, left: int) -> None:
            ended = f"ends after {trial.stood_s:.2f} s" if trial.reason else "stands"
            ended += f", {left} more to try" if left else ""
            print_note(f"{trial.contract or 'rehearsal'}: {ended}")

        found = rehearse_policy(network, contract, motion, said)
        if not self.json:
            print_lines(str(found))
        print_warning(*found.doubts)
        return found
