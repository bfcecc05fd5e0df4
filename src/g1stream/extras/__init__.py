"""What g1stream does with packages that not everybody needs; the core imports none of it."""
