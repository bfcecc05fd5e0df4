"""Diagnosis of DDS and of this machine: facts are gathered first, then evaluated purely."""
