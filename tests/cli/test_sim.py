from g1stream.cli.sim import render
from g1stream.sim.robot import SimReport


def test_the_text_is_the_snapshot(matches_snapshot):
    report = SimReport(
        states=30000,
        commands=9500,
        refused={"wrong CRC": 3, "mode_machine 4": 1},
        timeouts=2,
        simulated=60.0,
        elapsed=61.5,
        behind=1.5,
    )
    matches_snapshot("sim", f"{render(report)}\n\n{render(SimReport())}")
