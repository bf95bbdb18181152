"""The root of every error that saddlering_ros raises for something its user can put right."""


class SaddleringError(ValueError):
    """One thing the user can put right; the message is one line: what, where, what to do.

    Every layer derives its own class from this one. The command line prints the message
    alone on stderr and leaves with status 2; anything else that escapes is a defect.
    """
