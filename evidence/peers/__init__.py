"""Programs that are not tumble, rewritten from what they publish of their objectives: one file each."""

from evidence.peers import ardupilot, ferraris, gravity_norm, imu_tk, magnetic, magneto, mikoff, six_faces, thermal

PROGRAMS = (
    imu_tk.PROGRAM,
    mikoff.PROGRAM,
    gravity_norm.PROGRAM,
    magneto.PROGRAM,
    ardupilot.ELLIPSOID,
    ardupilot.SIX,
    ferraris.PROGRAM,
    six_faces.PX4,
    six_faces.SIX_FACES,
)

FURTHER = (
    imu_tk.PROGRAM,
    thermal.PX4,
    thermal.ARDUPILOT,
    magnetic.ELLIPSOID,
    magnetic.KOK_SCHON,
    magnetic.HUANG,
)
"""Those of recordings of other kinds than rests and turns."""
