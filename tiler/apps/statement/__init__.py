"""Statement on the objects left in a terrain, from a random sample of squares that an operator looks at.

`squares` finds the pixels that rise above the land around, counts them in squares and draws squares, `sample` has the
operator's answers, the draws that count and their bound, and `writing` writes the text and the page.
"""

from tiler.apps.statement.writing import Statement, write_statement

__all__ = ["Statement", "write_statement"]
