"""Which of many causes is new in a record, how large and since when: from two small matrices of each record.

A record is linearised at a point of all its coordinates x, the healthy parameters and the sizes of all causes (faults,
errors of sensors, the supply): r = J x + e. With the noise whitened, all that it says is its information G = JᵀJ and
its score g = Jᵀr. What the healthy records have said is the mean m and the covariance C of x before anything is new;
then F = (I + G C)⁻¹ G and h = (I + G C)⁻¹ (g − G m) are information and score of what *is* new, with the noise, the
errors of the baseline, their correlations and the drift in its covariance: generalised least squares. Everything else
follows from F and h.

References
----------
S. M. Kay, "Fundamentals of Statistical Signal Processing, volume II: Detection Theory", 1998, chapter 6; M. Basseville,
I. V. Nikiforov, "Detection of Abrupt Changes", 1993; R. E. Kass, A. E. Raftery, "Bayes factors", J. Am. Stat.
Assoc. 90, 1995; P. H. Westfall, S. S. Young, "Resampling-Based Multiple Testing", 1993.
"""
