"""What a G1 is: its joints, limits, links, and where these are. Knows no clock and no DDS."""
