from known_sessions import change, play, take, write_session

__all__ = ["change", "play", "take", "write_session"]
