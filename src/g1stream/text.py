"""Text for people: what a terminal would obey as escapes, and numbers of things."""

__all__ = ["counted", "printable"]


def printable(text: str) -> str:
    r"""The text with line breaks, control and invisible characters as escapes, such as `\x1b`."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def counted(n: int, noun: str) -> str:
    """`1 tick`, `2 ticks`."""
    return f"{n} {noun}{'s' * (n != 1)}"
