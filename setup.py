"""What pyproject.toml cannot say: conf/ is shipped as pinn_cli.conf, and hydra_plugins is a namespace of Hydra's."""

from setuptools import find_namespace_packages, find_packages, setup

setup(
    packages=[
        *find_packages(include=["pinn_cli", "pinn_cli.*"]),
        "pinn_cli.conf",
        *find_namespace_packages(include=["hydra_plugins", "hydra_plugins.*"]),
    ],
    package_dir={"pinn_cli.conf": "conf"},
)
