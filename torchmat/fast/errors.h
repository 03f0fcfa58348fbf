// Sums of errors of pictures, as `metrics._sums` has them: squared error, energy, squared errors on a display and of logarithms, and
// how many values count. One pass over the values of a sample, in a fixed number of strips.

enum { ERROR_SUMS = 5, ERROR_STRIPS = 8, ERROR_LANES = 8 };

// The encoding of sRGB, of values within 0 to 1.
static inline REAL NAME(encoded)(REAL x) {
    const REAL inside = x < 0 ? 0 : x > 1 ? 1 : x, knee = (REAL)0.0031308;
    const REAL root = NAME(power)(inside > knee ? inside : knee, (REAL)(1 / 2.4));
    return inside > knee ? (REAL)1.055 * root - (REAL)0.055 : inside != inside ? inside : (REAL)12.92 * inside;
}

// log(1 + 5000 x), of what is not below 0; what 1 + x rounds away is added.
static inline REAL NAME(logarithmic)(REAL x) {
    const REAL scaled = 5000 * (x < 0 ? 0 : x), whole = 1 + scaled;
    return NAME(logarithm)(whole) + (x - x == 0 ? (scaled - (whole - 1)) / whole : 0);
}

static inline void NAME(add_up)(double lanes[ERROR_LANES], const REAL *values) {
    for (int64_t i = 0; i < BLOCK; i += ERROR_LANES)
        for (int lane = 0; lane < ERROR_LANES; lane++) lanes[lane] += values[i + lane];
}

// Add the sums of values from `first` to `end` of one channel to `lanes`.
APART void NAME(errors_of_run)(
    const REAL *prediction, const REAL *target, const uint8_t *valid, const uint8_t *clipped, int64_t first, int64_t end,
    double lanes[ERROR_SUMS][ERROR_LANES]
) {
    const REAL unit = 1 / (REAL)8.517393171418904;  // the logarithm of 5001
    REAL found[ERROR_SUMS][BLOCK], p[BLOCK], t[BLOCK];
    for (int64_t at = first; at < end; at += BLOCK) {
        const int64_t some = at + BLOCK < end ? BLOCK : end - at;
        if (some < BLOCK) memset(found, 0, sizeof(found));
        for (int64_t i = 0; i < some; i++) {
            const REAL seen = target[at + i], told = prediction[at + i];
            const REAL kept = clipped[at + i] && seen < told ? seen : told;
            p[i] = valid[at + i] ? kept : 0, t[i] = valid[at + i] ? seen : 0;
            found[4][i] = valid[at + i] ? 1 : 0;
        }
        for (int64_t i = 0; i < some; i++) {
            const REAL apart = p[i] - t[i];
            found[0][i] = apart * apart, found[1][i] = t[i] * t[i];
        }
        for (int64_t i = 0; i < some; i++) {
            const REAL apart = NAME(encoded)(p[i]) - NAME(encoded)(t[i]);
            found[2][i] = apart * apart;
        }
        for (int64_t i = 0; i < some; i++) {
            const REAL apart = (NAME(logarithmic)(p[i]) - NAME(logarithmic)(t[i])) * unit;
            found[3][i] = apart * apart;
        }
        for (int sum = 0; sum < ERROR_SUMS; sum++) NAME(add_up)(lanes[sum], found[sum]);
    }
}

// Sums [count, 5] of pictures [count, 3, texels]; masks have 1 or 3 channels. `strips` is room for 8 times the sums.
void NAME(errors)(
    const REAL *prediction, const REAL *target, const uint8_t *valid, const uint8_t *clipped, int64_t count, int64_t texels,
    int64_t valid_channels, int64_t clipped_channels, double *strips, double *out, int64_t threads
) {
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < count * ERROR_STRIPS; part++) {
        const int64_t sample = part / ERROR_STRIPS, strip = part % ERROR_STRIPS;
        double lanes[ERROR_SUMS][ERROR_LANES] = {{0}};
        for (int64_t c = 0; c < 3; c++) {
            const int64_t at = (3 * sample + c) * texels;
            const uint8_t *counts = valid + (valid_channels * sample + (valid_channels == 3 ? c : 0)) * texels;
            const uint8_t *cut = clipped + (clipped_channels * sample + (clipped_channels == 3 ? c : 0)) * texels;
            const int64_t first = texels * strip / ERROR_STRIPS, end = texels * (strip + 1) / ERROR_STRIPS;
            NAME(errors_of_run)(prediction + at, target + at, counts, cut, first, end, lanes);
        }
        for (int sum = 0; sum < ERROR_SUMS; sum++) {
            double total = 0;
            for (int lane = 0; lane < ERROR_LANES; lane++) total += lanes[sum][lane];
            strips[part * ERROR_SUMS + sum] = total;
        }
    }
    for (int64_t i = 0; i < count * ERROR_SUMS; i++) {
        const int64_t sample = i / ERROR_SUMS, sum = i % ERROR_SUMS;
        double total = 0;
        for (int64_t strip = 0; strip < ERROR_STRIPS; strip++) total += strips[(sample * ERROR_STRIPS + strip) * ERROR_SUMS + sum];
        out[i] = total;
    }
}
