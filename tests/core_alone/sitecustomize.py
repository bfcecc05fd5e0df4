"""Hides `g1stream.extras` from a process: with this folder on PYTHONPATH, the core is alone."""

import sys


class _Hidden:
    """A finder that is asked first, and knows no extras."""

    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == "g1stream.extras":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, _Hidden)
