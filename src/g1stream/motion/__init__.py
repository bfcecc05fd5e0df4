"""Motion files, and what can be sampled from them at any time. Knows no clock and no DDS."""
