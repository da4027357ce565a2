"""Write a C runtime for Wine with complex arithmetic, which passes all other functions on to ``ucrtorig.dll``.

It reads the exports of that library, as ``objdump -p`` prints them, and writes NAME.c and NAME.def.
"""

import re
import sys
from pathlib import Path

OF_ONE = (
    *("conj", "sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan"),
    *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "proj"),
)
TO_REAL = ["creal", "cimag", "cabs", "carg"]

exports = [
    found[1]
    for line in sys.stdin
    if (found := re.search(r"\+base\[ *\d+\] +[0-9a-f]+ (\w+)", line))
]
lines = [
    "#include <complex.h>",
    "typedef struct { double r, i; } D;",
    "typedef struct { float r, i; } F;",
]
own = set()
for suffix, real, kind in (("", "double", "D"), ("f", "float", "F")):
    result = f"{{ {kind} o = {{ __real__ w, __imag__ w }}; return o; }}"
    for base in OF_ONE:
        name = f"{base if base == 'conj' else f'c{base}'}{suffix}"
        own.add(name)
        lines.append(
            f"{kind} my_{name}({kind} z) {{ {real} complex w = {name}(z.r + I * z.i); {result} }}"
        )
    for base in TO_REAL:
        own.add(base + suffix)
        lines.append(
            f"{real} my_{base}{suffix}({kind} z) {{ return {base}{suffix}(z.r + I * z.i); }}"
        )
    own.add(f"cpow{suffix}")
    lines.append(
        f"{kind} my_cpow{suffix}({kind} a, {kind} b) "
        f"{{ {real} complex w = cpow{suffix}(a.r + I * a.i, b.r + I * b.i); {result} }}"
    )
rows = [f"  {name} = {'my_' + name if name in own else 'ucrtorig.' + name}" for name in exports]
Path(f"{sys.argv[1]}.c").write_text("\n".join(lines) + "\n")
Path(f"{sys.argv[1]}.def").write_text(
    "\n".join(["LIBRARY ucrtbase.dll", "EXPORTS", *rows]) + "\n"
)
