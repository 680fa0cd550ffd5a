"""Where Hydra learns of `folder://`, the folders of `--config-dir` and `hydra.searchpath`."""

from pinn_cli.settings.yaml_file import ConfigFolder

__all__ = ["ConfigFolder"]
