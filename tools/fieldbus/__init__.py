"""The kinds of fieldbuses as the tools know them: what each builds, checks and examines."""
