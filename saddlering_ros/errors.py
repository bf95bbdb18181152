"""The root of every error that saddlering_ros raises for something its user can put right."""


class SaddleringError(ValueError):
    """One thing the user can put right; the message is one line: what, where, what to do.

    Every layer derives its own class from this one. The command line prints the message
    alone on stderr and leaves with status 2; anything else that escapes is a defect.
    """


class Cancelled(SaddleringError):
    """The caller asked a computation to stop; the one class for every computation here.

    `partial` is what had been found by then, where there is something to show.
    """

    def __init__(self, message: str = 'cancelled', partial: object = None) -> None:
        super().__init__(message)
        self.partial = partial
