"""Search of a whole box before Marquardt's search, for criteria with secondary optima (docs/method.md section 4).

Two ways to spread over the box, both ending in Marquardt's search from several points:

- evolution: differential evolution (Storn and Price; scipy's), a generation in one batch of simulations. When the
  generation agrees, its best goes to Marquardt's search, and so do other points that are better than all their nearest
  neighbours among the points ever tried (Törn and Viitanen's topographs), unless they lie in the valley of an optimum
  already found, where the criterion nowhere rises on the way to it (Ursem). Secondary optima show there.
- multistart: Marquardt's search from every point of a Sobol sequence whose simulation succeeds, and from the
  parameters' own starts. How many starts led to an optimum tells how likely an ordinary search is to miss it.

The fits run one after the other: each simulates the columns of its Jacobian as a batch already, and the single
simulations of its steps are too small a share for fits in lockstep to gain more than a tenth.

What is compared: with all noise variances given, the compound criterion J_C (1.37). Where they are estimated, J_C means
nothing until they are, so the estimates σ̂_j² = J_j/K_j that any theta implies are put into the likelihood, which gives
the concentrated criterion Σ K_j ln σ̂_j² + prior rows. Its least value is where the repetition on them settles.

References
----------
R. Storn, K. Price, "Differential evolution", J. Global Optimization 11, 1997;
A. Törn, S. Viitanen, "Topographical global optimization", in Recent Advances in Global Optimization, 1992;
R. K. Ursem, "Multinational evolutionary algorithms", Congress on Evolutionary Computation, 1999;
G. A. F. Seber, C. J. Wild, "Nonlinear Regression", section 2.2.3 (concentrated likelihood), 1989.
"""
