"""The root of all errors that the user of saddlering_ros can correct."""


class SaddleringError(ValueError):
    """An error that the user can correct; the message is one line: fault, place, remedy.

    Every layer derives its own class from this one. The command line prints the message
    alone on stderr and exits with status 2; any other exception is a defect.
    """


class Cancelled(SaddleringError):
    """A computation was stopped by its caller; the same class for every computation.

    `partial` is the result so far, if there is one.
    """

    def __init__(self, message: str = 'cancelled', partial: object = None) -> None:
        super().__init__(message)
        self.partial = partial
