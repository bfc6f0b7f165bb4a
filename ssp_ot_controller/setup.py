from glob import glob

from setuptools import find_packages, setup

package_name = "ssp_ot_controller"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["*.yaml", "*.j2", "*.css", "*.js", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*.yaml")),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
    ],
    zip_safe=True,
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "sil_world = ssp_ot_controller.ros.sil_world:main",
            "front_camera = ssp_ot_controller.ros.front_camera:main",
            "object_target = ssp_ot_controller.ros.object_target:main",
            "vut_driver = ssp_ot_controller.ros.vut_driver:main",
            "vut_adapter = ssp_ot_controller.ros.vut_adapter:main",
            "rehearsal = ssp_ot_controller.rehearsal.__main__:run",
        ]
    },
)
