"""Installs the package where ROS looks for it."""

from pathlib import Path

from setuptools import setup

NAME = "rholoc_ros"


def files(folder: str) -> list[str]:
    return sorted(str(path) for path in Path(folder).iterdir() if path.is_file())


setup(
    name=NAME,
    version="1.0.0",
    description="Visual localization in a map of rholoc, as a ROS 2 lifecycle node.",
    license="Apache-2.0",
    packages=[NAME],
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", files("launch")),
        (f"share/{NAME}/config", files("config")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    entry_points={
        "console_scripts": [
            f"localization = {NAME}.node:main",
            f"write_floor_plan = {NAME}.floor_plan:main",
        ]
    },
)
