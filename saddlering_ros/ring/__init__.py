"""What the ring does: contact, equilibrium, dynamics; a readable reference and the fast kernels."""
