"""A verdict in a word."""


def verdict(condition: bool) -> str:
    """What to say of a claim that was found to be true, or not to be."""
    return "holds" if condition else "fails"


def among(true: dict[str, bool] | dict[str, bool | None]) -> str:
    """The same of what was looked at in several scenes; "open" where one of them (None) did not decide it."""
    if None in true.values():
        return "open"
    if all(true.values()) or not any(true.values()):
        return verdict(all(true.values()))
    return f"holds if the scene is {' or '.join(name for name, yes in true.items() if yes)}"
