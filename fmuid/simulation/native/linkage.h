/* How functions are linked. */
#ifndef LINKAGE_H
#define LINKAGE_H

/* What is seen from outside. The rest is hidden: a library that was loaded before and exports such a name would take
 * the calls over. On Windows all is seen and nothing taken over. */
#ifdef _WIN32
#define EXPORT
#else
#define EXPORT __attribute__((visibility("default")))
#endif

#define INLINE static inline __attribute__((always_inline))

#endif
