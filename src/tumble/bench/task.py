"""What is to be recorded at a bench: the session, its programme, and the uncertainties that are wanted."""

from __future__ import annotations

from dataclasses import dataclass

from tumble.bench.wishes import Wanted
from tumble.programme.positions import ANY_MOVE, Move, Programme, from_attitudes
from tumble.programme.positions import programme as built_in
from tumble.recording.session import Session


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Task:
    """A session, its programme, None in free positions, the grade of its unit and what is `wanted` of it."""

    session: Session
    programme: Programme | None
    grade: str
    wanted: Wanted

    @staticmethod
    def of(session: Session, wanted: Wanted, grade: str) -> Task:
        """Of a session; `grade` is that of a unit whose session does not say one."""
        return Task(
            session=session, programme=_programme_of(session), grade=session.device.grade or grade, wanted=wanted
        )

    @property
    def positions(self) -> int | None:
        """How many positions there are to take; None where they are free."""
        return None if self.programme is None else len(self.programme.positions)

    def move(self, index: int) -> Move:
        """The turn into a position, from 0, of the programme; any where its order or its positions are free."""
        ordered = self.programme is not None and self.programme.ordered and 0 < index <= len(self.programme.moves)
        return self.programme.moves[index - 1] if ordered and self.programme is not None else ANY_MOVE


def _programme_of(session: Session) -> Programme | None:
    spec = session.programme
    if spec is None:
        return None
    return built_in(spec.name) if spec.name is not None else from_attitudes([p.attitude for p in spec.positions])
