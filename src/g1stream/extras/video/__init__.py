"""Videos and pictures of sessions."""
