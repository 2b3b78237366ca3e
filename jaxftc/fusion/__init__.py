"""What XLA's CPU compiler is told of a program before it compiles it: where not to fuse, or to make one function of it.

Large arrays: XLA turns a step of thousands of small operations into loops ("fusions") and draws the arithmetic of a value
into every loop that uses it. In rigid-body recursions, and more so in their reverse mode, that repeats whole recursions for
each of their results; and a loop that writes the parts of a concatenated array one after the other is not vectorised.
``planned`` counts what would be repeated, and puts a fence behind every value that is cheaper to store than to compute
again, on both sides of every array that is put together from parts, and behind every array that is computed and then taken
apart (a loop that computes what it takes parts of is not vectorised either). A fence is ``jax.lax.optimization_barrier``: it
changes numbers by rounding only. CPU compilers strip barriers before they fuse, unless told not to (``compile.py``). A plan
is made for each loop body and is good for one set of shapes. What is around a loop over time is taken to cost little beside
it, and gets few fences.

What has no fence is written out again for every loop that uses it (``plan.py``, ``Program.loops``). XLA does so by itself,
but not where loops may have several results: there it would store every value with several uses, and then join those loops
that read the same. Written out, what they have in common is inside the joined loop and is computed once.

Small arrays: calling a loop takes longer than running it. ``whole`` marks the program as a small call, which XLA emits as
one function, loops over time included.

Nothing here knows robots.
"""
