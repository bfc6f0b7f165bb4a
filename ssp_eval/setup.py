from glob import glob

from setuptools import find_packages, setup

package_name = "ssp_eval"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={"": ["*.yaml", "*.json", "*.j2", "*.css", "*.js", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*.yaml")),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
    ],
    zip_safe=True,
    license="Apache-2.0",
    entry_points={"console_scripts": ["evaluator = ssp_eval.ros.evaluator_node:main"]},
)
