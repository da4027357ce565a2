"""Statement on the objects left in a terrain, from a random sample of squares that an operator looks at.

`rising` finds the pixels that rise above the land around, `squares` counts them in squares and draws squares, `answers`
reads the operator's answers, `sample` has the draws that count and their bound, `words` is the text, and `writing`
writes the page.
"""

from tiler.apps.statement.writing import Statement, write_statement

__all__ = ["Statement", "write_statement"]
