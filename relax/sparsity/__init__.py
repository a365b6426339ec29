"""What "few supports" means: where supports may act, and what each costs."""
