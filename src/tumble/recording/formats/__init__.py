"""Recordings in other formats than CSV and Parquet: what they hold, and how it becomes a log.

A recording is a list of `Message` kinds (a topic of a bag, a message of a flight log, a group of arrays), each with the
sensors found in it and their units. `as_log` writes those of one kind, or accelerometers and gyros of two kinds, as one
Parquet file, which a session can name. One reader per format, each behind the extra `formats`:

    .bag, .db3, .mcap, folder     ROS 1 and 2              ros
    .ulg                          PX4                      ulog
    .bin, .log                    ArduPilot                ardupilot
    .mat, .h5, .hdf5              arrays                   arrays
"""

from tumble.recording.formats.message import Message, Sensors
from tumble.recording.formats.recording import ENDINGS, as_log, is_recording, messages

__all__ = ["ENDINGS", "Message", "Sensors", "as_log", "is_recording", "messages"]
