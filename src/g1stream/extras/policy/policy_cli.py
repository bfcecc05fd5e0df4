"""`g1stream policy`: shows the inputs and outputs of a policy, and checks them."""

from __future__ import annotations

from dataclasses import dataclass

from g1stream.cli.command import (
    EXIT_OK,
    EXIT_STOPPED,
    Command,
    print_json,
    print_lines,
    print_warning,
)
from g1stream.cli.flags import flag
from g1stream.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class Policy(Command):
    """Prints the contract of a learned policy: observation, joints, gains, rate, reference.

    A policy is an ONNX file, or the name of a published one, such as holosoma, which is downloaded
    once. Facts that its metadata lacks are read from deploy.yaml or from a TOML
    file of the same name beside it. Facts that no file has are listed with the line to write. With
    a motion in the policy or --motion, the first five seconds are tried with the robot exactly at
    the reference. Targets far from it show a wrong motion, order, term or scale.

    --replay feeds the recorded observations to the policy and checks that it gives the recorded
    actions, bit for bit. It also compares observations recomputed from LowState and Reference with
    the recorded ones, term by term, and targets, gains and torques that were sent with those of the
    policy.

    Examples:
      g1stream policy holosoma
      g1stream policy policy.onnx
      g1stream policy policy.onnx --motion dance.csv --json
      g1stream policy holosoma --toml > policy.toml
      g1stream policy --replay session.mcap

    Exit codes:
      0  printed
      1  printed, but the first targets are far off, or a replay differs
      2  a fact is missing or wrong, no policy for a G1, or no policy in the session
    """

    file: str | None = flag(
        None,
        "ONNX file of the policy, or name of a published one; default: the recorded one.",
        "FILE",
        positional=True,
    )
    motion: str | None = flag(None, "Motion to track.", "MOTION", excludes=("replay",))
    replay: str | None = flag(None, "Session whose observations the policy gets.", "SESSION")
    json: bool = flag(False, "Print the result as JSON.")
    toml: bool = flag(
        False,
        "Print the facts as TOML, to write them beside another policy.",
        excludes=("json", "replay"),
    )

    def run(self) -> int:
        """Print contract and first actions, or a replay, and return the exit code."""
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

        found = replay_policy(open_session(path), self.file)
        if self.json:
            print_json(found.model_dump(mode="json") | {"same": found.same})
        else:
            print_lines(str(found))
        return EXIT_OK if found.same else EXIT_STOPPED

    def _show(self, file: str) -> int:
        from g1stream.extras.policy.contract import read_contract
        from g1stream.extras.policy.first_actions import first_actions
        from g1stream.extras.policy.network import Network
        from g1stream.motion.readers import load_motion
        from g1stream.robot.model import G1
        from g1stream.text import labelled

        network = Network(file)
        contract = read_contract(network)
        if self.toml:
            print_lines(contract.toml())
            return EXIT_OK
        print_warning(*contract.doubts)
        motion = load_motion(self.motion) if self.motion else None
        if motion:
            print_warning(*motion.warnings)
        actions = first_actions(contract, network, G1.default(), motion)
        if self.json:
            first = actions.model_dump(mode="json") if actions else None
            print_json(contract.model_dump(mode="json") | {"first_actions": first})
        else:
            print_lines(str(contract))
            if actions:
                print_lines(labelled("first actions   ", str(actions)))
            if actions and actions.problem:
                print_lines(labelled("problem         ", actions.problem))
        return EXIT_STOPPED if actions and actions.problem else EXIT_OK
