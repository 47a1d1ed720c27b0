"""The one error that means the user can put it right."""


class InputError(ValueError):
    """Something the user gave is wrong: a file, a number, a name.

    The message is one line that says what is wrong, where, and what to do. The command line
    prints it as it stands and exits with code 2; every other exception is a fault of ours.
    """
