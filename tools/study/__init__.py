"""Studies of parameters: many runs from one file, a row of figures for each, one table and page.

`trials` says which runs there are and `provenance` what their rows depend on; `play` makes a row of
one, `engine` plays them on several processors, `store` keeps the rows and writes the table, `page`
shows it.
"""
