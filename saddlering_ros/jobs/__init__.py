"""Work of the action servers: one goal at a time, each in a worker process."""
