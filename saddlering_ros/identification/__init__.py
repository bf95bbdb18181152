"""From test runs to contact parameters, how far they can be trusted, and how well they predict."""
