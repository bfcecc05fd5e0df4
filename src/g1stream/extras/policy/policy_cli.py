"""`g1stream policy`: what a policy takes and gives."""

from __future__ import annotations

from dataclasses import dataclass

from g1stream.cli.command import EXIT_OK, EXIT_STOPPED, Command, print_json, print_lines
from g1stream.cli.flags import argument, flag


@dataclass(frozen=True, kw_only=True)
class Policy(Command):
    """Prints what a learned policy takes and gives: observation, joints, gains, rate, reference.

    A policy is an ONNX file. What its metadata does not say is read from deploy.yaml or from a TOML
    file of the same name beside it; what no file says is named, with the line to write. With a
    motion, its or the given one, the first five seconds are tried with the robot exactly where the
    reference is: targets that are far from it show a wrong motion, order, term or scale.

    Examples:
      g1stream policy policy.onnx
      g1stream policy policy.onnx --motion dance.csv --json

    Exit codes:
      0  printed
      1  printed, and the first targets are far from the reference
      2  a fact is missing or wrong, or it is no policy of a G1
    """

    file: str = argument("ONNX file of the policy.", "FILE")
    motion: str | None = flag(None, "Motion that it is to track.", "MOTION")
    json: bool = flag(False, "Print it as JSON.")

    def run(self) -> int:
        """Print the contract and the first actions, and return the exit code."""
        from g1stream.extras.policy.contract import read_contract
        from g1stream.extras.policy.first_actions import first_actions
        from g1stream.extras.policy.network import Network
        from g1stream.motion.readers import load_motion
        from g1stream.robot.model import G1
        from g1stream.text import labelled

        network = Network(self.file)
        contract = read_contract(network)
        motion = load_motion(self.motion) if self.motion else None
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
