"""What the `recslam` command does; `services/cli.py` is its face."""
