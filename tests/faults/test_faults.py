"""Every fault of the table, over real DDS, as the motors of a robot see it."""

import pytest
from table import FAULTS


@pytest.mark.timeout(300)  # its turn may come late
@pytest.mark.parametrize("fault", FAULTS, ids=[fault.name for fault in FAULTS])
def test_fault(fault, outcome_of):
    if fault.impossible:
        pytest.skip(fault.impossible)
    outcome = outcome_of(fault)
    assert outcome.wrong == [], outcome.said[-3000:]
