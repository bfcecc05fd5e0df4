"""A motion found in a recording of another program; the bags and logs of other programs."""
