"""The one exception for wrong input, shared by every package, and how it is said."""

from __future__ import annotations


class InputError(ValueError):
    """Input that the user can mend; the command line prints it and exits with 2.

    ``problems`` holds one line each, in the form ``where: what: got X, wanted Y``.
    """

    def __init__(self, *problems: str) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(problems))


def problem(where: object, what: str, got: object, wanted: object) -> str:
    """One line for a person: ``where: what: got X, wanted Y``."""
    return f"{where}: {what}: got {got}, wanted {wanted}"
