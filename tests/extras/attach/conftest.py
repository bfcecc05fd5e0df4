from written_sessions import record, write_session

__all__ = ["record", "write_session"]
