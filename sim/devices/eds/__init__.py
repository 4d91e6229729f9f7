"""A drive made from its electronic data sheet: the sheet's dictionary on the CiA 402 core."""
