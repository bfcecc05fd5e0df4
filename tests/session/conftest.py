"""Session files made of samples whose figures are known, as a fixture."""

from written_sessions import write_session

__all__ = ["write_session"]
