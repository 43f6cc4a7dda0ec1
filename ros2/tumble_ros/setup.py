"""The package as ament builds it."""

from setuptools import setup

NAME = "tumble_ros"
setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/correct.launch.py"]),
        (f"share/{NAME}/config", ["config/corrector.yaml"]),
    ],
    install_requires=["setuptools", "tumble"],
    zip_safe=True,
    maintainer="tumble contributors",
    description="Corrects sensor_msgs/Imu with a calibration of tumble, and records for one",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [f"corrector = {NAME}.corrector:main", f"recorder = {NAME}.recorder:main"],
    },
)
