"""The mechanics of the ring: contact, equilibrium, dynamics, tangents; compiled in `kernels/`."""
