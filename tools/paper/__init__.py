"""The paper's protocol: its trials, what they came to, and its tables beside ours."""
