"""Sessions of instruments that are linear, as their data sheets say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from tumble.recording.session import Session
from tumble.recording.session_file import read_session
from tumble.sensors.parameters import further_groups


def stated_linear(folder: Path) -> Session:
    """A session whose device has, by its data sheet, nothing but bias, scale factor and axis angles."""
    session = read_session(folder)
    sheet = {group.name: 1e-12 * group.limit for group in further_groups()}
    return replace(session, device=replace(session.device, prior=sheet))
