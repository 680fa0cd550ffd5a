"""What `pinn-run` plugs into Hydra, which looks for its plugins in the namespace `hydra_plugins` at every start.

So nothing slow is imported here: the work is done by `pinn_cli.sweep`, which is imported when a sweep begins. By the
class that is imported here Hydra learns of `folder://`, the folders of `--config-dir` and `hydra.searchpath`.
"""

from pinn_cli.settings.yaml_file import ConfigFolder

__all__ = ["ConfigFolder"]
