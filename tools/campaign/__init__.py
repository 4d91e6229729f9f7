"""Studies of many episodes: drawn, played, judged, recorded, and reduced where a bound broke."""
