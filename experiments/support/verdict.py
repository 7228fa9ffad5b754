"""A verdict in a word."""


def verdict(condition: bool) -> str:
    """What to say of a claim that was found to be true, or not to be."""
    return "holds" if condition else "fails"
