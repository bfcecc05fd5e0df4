"""Libraries: check, simulate or convert many motions."""
