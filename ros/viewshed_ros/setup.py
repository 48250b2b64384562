"""The ROS 2 package around viewshed: ``colcon build``, or ``pip install`` where ROS comes as wheels."""

from pathlib import Path

from setuptools import setup

NAME = "viewshed_ros"
FOLDERS = ("launch", "config", "rviz")

setup(
    name=NAME,
    version="0.4.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *((f"share/{NAME}/{folder}", [str(file) for file in sorted(Path(folder).iterdir())]) for folder in FOLDERS),
    ],
    install_requires=["setuptools", "viewshed"],
    zip_safe=True,
    maintainer="viewshed maintainers",
    maintainer_email="maintainers@viewshed.invalid",
    description="Field of view of LiDARs in bird's-eye view, live",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"field_of_view = {NAME}.node:main",
            f"viewshed_adversary = {NAME}.adversary:main",
            f"viewshed_center = {NAME}.center:main",
            f"watchdog = {NAME}.watchdog:main",
        ]
    },
)
