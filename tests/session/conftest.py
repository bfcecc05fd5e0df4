from written_sessions import write_session

__all__ = ["write_session"]
