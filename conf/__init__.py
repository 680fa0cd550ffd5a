"""The shipped configuration: Hydra reads it as `pkg://pinn_cli.conf`."""
