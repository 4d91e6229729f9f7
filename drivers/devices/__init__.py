"""What each kind of device is, whatever bus it is on: objects, scaling, states, errors."""
