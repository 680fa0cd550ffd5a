"""What `pinn-run` plugs into Hydra, which looks for its plugins in the namespace `hydra_plugins` at every start.

So nothing slow is imported here: the work is done by `pinn_cli.sweep`, which is imported when a sweep begins.
"""
