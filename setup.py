"""What pyproject.toml cannot say: conf/ stays at the top level and is shipped as the package pinn_cli.conf."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["pinn_cli", "pinn_cli.*"]), "pinn_cli.conf"],
    package_dir={"pinn_cli.conf": "conf"},
)
