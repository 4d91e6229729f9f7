"""The safety evidence: hazards, controls, requirements, failure modes and tests from one source
(docs/safety), checked both ways and printed as pages."""
