// What loops over texels share and a compiler can make of vectors: logarithm, power, unit vectors, directions and what is shown.
//
// As in torchmat/safe.py: what is below the smallest normal number counts as 0, and NaN stays NaN.

// As many as SOME of distribution.h.
enum { BLOCK = 64 };  // texels that go through all steps together, so that what lies between them stays near
// Compiled once, not into every place that calls it: that takes the compiler twice as long.
#define APART static __attribute__((noinline))

typedef union {
    REAL real;
    WHOLE whole;
} NAME(Bits);

static inline REAL NAME(above)(REAL x, REAL least) { return x < least ? least : x; }

// 2 artanh((m - 1) / (m + 1)) of the mantissa m between the roots of 1/2 and of 2, and the exponent's share.
static inline REAL NAME(logarithm)(REAL x) {
    const NAME(Bits) bits = {x}, middle = {(REAL)M_SQRT1_2};
    const WHOLE exponent = (bits.whole - middle.whole) >> MANTISSA;
    const NAME(Bits) mantissa = {.whole = bits.whole - (WHOLE)((UNSIGNED)exponent << MANTISSA)};
    const REAL s = (mantissa.real - 1) / (mantissa.real + 1), square = s * s;
    REAL sum = 0;
    for (int k = LOGARITHM_TERMS; k >= 0; k--) sum = sum * square + 1 / (REAL)(2 * k + 1);
    const REAL found = 2 * s * sum + (REAL)M_LN2 * (REAL)exponent;
    return x - x == 0 ? found : x;
}

// Taylor's series of what is left between half powers of 2, and that power put into the exponent's bits.
static inline REAL NAME(exponential)(REAL x) {
    const NAME(Bits) turns = {x * (REAL)M_LOG2E + WHOLE_AT};
    const REAL whole = turns.real - WHOLE_AT, rest = (x - whole * LN2_HIGH) - whole * LN2_LOW;
    REAL sum = 1;
    for (int k = EXPONENTIAL_TERMS; k > 0; k--) sum = sum * (rest * (1 / (REAL)k)) + 1;
    const NAME(Bits) scale = {.whole = (WHOLE)(((UNSIGNED)turns.whole + BIAS) << MANTISSA)};
    const REAL found = sum * scale.real;
    return x > MOST_EXPONENT ? (REAL)INFINITY : x < -MOST_EXPONENT ? 0 : found;
}

static inline REAL NAME(power)(REAL base, REAL exponent) {
    const REAL found = NAME(exponential)(exponent * NAME(logarithm)(base < TINY ? 1 : base));
    return base < TINY ? (REAL)(exponent == 0) : found;
}

static inline REAL NAME(ratio)(REAL numerator, REAL denominator) {
    return ABSOLUTE(denominator) < TINY ? 0 : numerator / denominator;
}

// Scale vectors to unit length; one of length 0 stays so.
APART void NAME(normalised)(const REAL *x, const REAL *y, const REAL *z, int64_t some, REAL to[3][BLOCK]) {
    for (int64_t i = 0; i < some; i++) {
        const REAL a = ABSOLUTE(x[i]), b = ABSOLUTE(y[i]), c = ABSOLUTE(z[i]), most = a > b ? a : b;
        const REAL largest = (most > c ? most : c) + (0 * a + 0 * b + 0 * c);  // NaN where one is
        const REAL whole = largest < TINY ? 1 : largest, kept = largest < TINY ? 0 : 1;
        const REAL u = x[i] * kept / whole, v = y[i] * kept / whole, w = z[i] * kept / whole;
        const REAL squared = u * u + v * v + w * w, shrink = squared < TINY ? 0 : 1 / SQRT(squared);
        to[0][i] = u * shrink, to[1][i] = v * shrink, to[2][i] = w * shrink;
    }
}

// Directions [count, 3, places]: one of them may serve all samples, and one place all texels.
typedef struct {
    const REAL *at;
    int64_t count, places;
} NAME(Directions);

// Let x, y and z of a sample's block be found at `to`; what serves all texels is written out in `room`.
APART void NAME(along)(
    const NAME(Directions) *of, int64_t number, int64_t first, int64_t some, REAL room[3][BLOCK], const REAL *to[3]
) {
    const REAL *from = of->at + (of->count == 1 ? 0 : number) * 3 * of->places;
    for (int axis = 0; axis < 3; axis++) {
        to[axis] = from + axis * of->places + first;
        if (of->places > 1) continue;
        for (int64_t i = 0; i < some; i++) room[axis][i] = from[axis];
        to[axis] = room[axis];
    }
}

// Store a value as it is shown: not below 0, and 0 where light or view is not above the horizon.
APART void NAME(show)(const REAL *value, const REAL *light_z, const REAL *view_z, int64_t some, REAL *out) {
    for (int64_t i = 0; i < some; i++) {
        const REAL shown = NAME(above)(value[i], 0);
        out[i] = (light_z[i] > 0) & (view_z[i] > 0) ? shown : 0;
    }
}
