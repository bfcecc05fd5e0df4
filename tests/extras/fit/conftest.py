import importlib.util
import sys
from pathlib import Path

import pytest

PATH = Path(__file__).parents[3] / "benchmarks" / "foreign_robot.py"


@pytest.fixture(scope="session")
def foreign():
    """The class of robots of a simulator that is not g1stream's."""
    spec = importlib.util.spec_from_file_location("foreign_robot", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # a dataclass looks there for its types
    spec.loader.exec_module(module)
    return module.Foreign
