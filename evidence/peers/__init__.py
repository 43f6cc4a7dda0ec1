"""Programs that are not tumble, rewritten from what they publish of their objectives: one file each."""

from evidence.peers import ardupilot, ferraris, gravity_norm, imu_tk, magneto, mikoff, six_faces

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
