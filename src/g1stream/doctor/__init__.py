"""Diagnosis of DDS and of this machine; it gathers facts first, and then evaluates them."""
