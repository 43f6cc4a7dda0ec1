"""The instrument: model of the sensors, frames, grades."""
