// Everything that is compiled: each part once in single and once in double precision.
//
// Whatever is shared out among threads is worked out by one of them, in one order, so that no bit depends on how many
// there are. REAL is the precision, NAME(x) the name of x in it.

#include <math.h>
#include <stdint.h>
#include <string.h>

#define JOINED(a, b) a##b
#define AS(name, ending) JOINED(name, ending)

// Whether there can be more than one thread.
int torchmat_shares(void) {
#ifdef _OPENMP
    return 1;
#else
    return 0;
#endif
}

// Changes where what the functions take does: a part that was kept from before is not used.
int torchmat_version(void) { return 1; }

#define REAL float
#define NAME(x) AS(x, _float)
#define FLOOR floorf
#define SQRT sqrtf
#define CEIL ceilf
#include "look_up.h"
#include "rays.h"
#include "distribution.h"
#undef REAL
#undef NAME
#undef FLOOR
#undef SQRT
#undef CEIL

#define REAL double
#define NAME(x) AS(x, _double)
#define FLOOR floor
#define SQRT sqrt
#define CEIL ceil
#include "look_up.h"
#include "rays.h"
#include "distribution.h"
