"""One convex step: a quadratic distance and weighted group norms under linear equilibrium, and who can solve it."""
