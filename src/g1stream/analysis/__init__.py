"""How well a session went: tracking, timing, summary and plots."""
