"""Many motions at once."""
