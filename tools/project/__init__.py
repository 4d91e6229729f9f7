"""A project of a user's own with HIL tests, written from a template: `tonus new`."""
