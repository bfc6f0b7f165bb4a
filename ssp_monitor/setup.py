from glob import glob

from setuptools import find_packages, setup

package_name = "ssp_monitor"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["*.yaml", "*.j2", "*.html", "*.css", "*.js", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*")),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
    ],
    zip_safe=True,
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "monitor = ssp_monitor.ros.monitor_node:main",
            "page = ssp_monitor.ros.page_node:main",
            "replay = ssp_monitor.replay_cli:main",
            "view = ssp_monitor.ros.view_node:main",
        ]
    },
)
