"""An observer that raises costs no run: it ends there, and what was simulated is handed out with the error."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from experiments.recording.recording import Recording
from experiments.running.loop import ClosedLoop, Observer
from robots.errors import SafeWbcError
from robots.messages import RobotState

T = TypeVar("T")


class ObserverError(SafeWbcError):
    """An observer raised, and the run ended at that control period; the cause of this is what it raised.

    Attributes:
        recording: what was simulated until then; its ``stop_cause`` tells.
    """

    def __init__(self, cause: str, recording: Recording) -> None:
        super().__init__(cause)
        self.recording = recording


class Guarded(Observer):
    """Tells another observer until that raises; then it ends the run.

    Attributes:
        error: what it raised.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self.error: Exception | None = None

    def began(self, loop: ClosedLoop[Any]) -> None:
        """See :meth:`Observer.began`."""
        self._call(self._observer.began, None, loop)

    def ticked(self, loop: ClosedLoop[Any], state: RobotState, output: Any, seconds: float) -> None:
        """See :meth:`Observer.ticked`."""
        self._call(self._observer.ticked, None, loop, state, output, seconds)

    def stepped(self, loop: ClosedLoop[Any]) -> None:
        """See :meth:`Observer.stepped`."""
        self._call(self._observer.stepped, None, loop)

    def ends(self, loop: ClosedLoop[Any]) -> bool:
        """See :meth:`Observer.ends`."""
        over = self._call(self._observer.ends, True, loop)
        self.ended_by = self.ended_by or self._observer.ended_by
        return over

    def ended(self, loop: ClosedLoop[Any]) -> None:
        """See :meth:`Observer.ended`."""
        self._call(self._observer.ended, None, loop)

    def _call(self, tell: Callable[..., T], otherwise: T, *what: Any) -> T:
        """What the observer answers, or ``otherwise`` once it has raised."""
        if self.error is None:
            try:
                return tell(*what)
            except Exception as error:
                self.error = error
                self.ended_by = f"{type(self._observer).__name__} raised {type(error).__name__}: {error}"
        return otherwise


def raise_errors_of(observers: Sequence[Guarded], recording: Recording) -> None:
    """Raise what the first of some observers raised while the recording was made, if one did.

    Raises:
        ObserverError: with the recording.
    """
    for observer in observers:
        if observer.error is not None:
            raise ObserverError(str(observer.ended_by), recording) from observer.error
