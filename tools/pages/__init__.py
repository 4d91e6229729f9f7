"""HTML pages that need nothing but themselves: one style and one engine for all of them."""
