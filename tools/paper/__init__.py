"""The paper's protocol: its tests as cases, every trial of a campaign, and what they come to."""
