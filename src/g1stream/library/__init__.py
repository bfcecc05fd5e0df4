"""Many motions at once: found, computed in many processes or on a cluster, kept as a table."""
