"""The devices of the lab, each without a bus: drives, force cells and the optical tracker."""
