"""The ROS 2 package around viewshed: ``colcon build``, or ``pip install`` where ROS comes as wheels."""

from glob import glob

from setuptools import setup

NAME = "viewshed_ros"

setup(
    name=NAME,
    version="0.3.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.py")),
        (f"share/{NAME}/config", glob("config/*")),
        (f"share/{NAME}/rviz", glob("rviz/*.rviz")),
    ],
    install_requires=["setuptools", "viewshed"],
    zip_safe=True,
    maintainer="viewshed maintainers",
    maintainer_email="maintainers@viewshed.invalid",
    description="Field of view of LiDARs in bird's-eye view, live",
    license="Apache-2.0",
    entry_points={"console_scripts": [f"field_of_view = {NAME}.node:main"]},
)
