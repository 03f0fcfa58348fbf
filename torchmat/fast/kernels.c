// Everything that is compiled, in single precision, or in double where DOUBLE is defined: each is a part of its own.
//
// Whatever is shared out among threads is worked out by one of them, in one order, so that no bit depends on how many
// there are. REAL is the precision, NAME(x) the name of x in it.

#include <float.h>
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
int torchmat_version(void) { return 2; }

#ifdef DOUBLE
#define REAL double
#define WHOLE int64_t
#define UNSIGNED uint64_t
#define MANTISSA 52
#define BIAS 1023
#define WHOLE_AT 6755399441055744.0  // 1.5 2^52
#define LN2_HIGH 0.693147180369123816490
#define LN2_LOW 1.90821492927058770002e-10
#define MOST_EXPONENT 708.3
#define LOGARITHM_TERMS 11
#define EXPONENTIAL_TERMS 13
#define TINY DBL_MIN
#define ABSOLUTE fabs
#define NAME(x) AS(x, _double)
#define FLOOR floor
#define SQRT sqrt
#define CEIL ceil
#else
#define REAL float
#define WHOLE int32_t
#define UNSIGNED uint32_t
#define MANTISSA 23
#define BIAS 127
#define WHOLE_AT 12582912.0f  // 1.5 2^23: what is added to it leaves its whole part in the last bits
#define LN2_HIGH 0.693359375f
#define LN2_LOW -2.12194440e-4f
#define MOST_EXPONENT 87.3f
#define LOGARITHM_TERMS 4
#define EXPONENTIAL_TERMS 8
#define TINY FLT_MIN
#define ABSOLUTE fabsf
#define NAME(x) AS(x, _float)
#define FLOOR floorf
#define SQRT sqrtf
#define CEIL ceilf
#endif
#include "elementary.h"
#include "look_up.h"
#include "rays.h"
#include "distribution.h"
#include "sums.h"
#include "neighbours.h"
#include "distribution_misfit.h"
#include "frames.h"
#include "roughness.h"
#include "errors.h"
#include "microfacet.h"
#include "distribution_shown.h"
