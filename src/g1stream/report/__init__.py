"""How well a session went: metrics, a summary and a picture."""
