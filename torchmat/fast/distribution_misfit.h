// How far the distribution material is from samples on a surface, and the gradients of all that it is made of: one pass, in which
// each sample of a texel is looked at once.
//
// It is the sum over samples of weight * (shown(lit * value + ambient) - shown(sample))^2, where a display shows (x + darkest)^power,
// or, with a power of 0, x as it is.

// Samples on the surface: `rows` [count] of `pixels` [any, 3, texels] and `flags` [any, texels], each flag with a weight of `weights`;
// `lit_rows` [count] of `lit` [any, texels], NULL where all is lit; `ambient` [3, texels] or NULL.
typedef struct {
    const REAL *pixels, *lit, *ambient, *weights;
    const uint8_t *flags;
    const int64_t *rows, *lit_rows;
    REAL darkest, power;
} NAME(Samples);

// What a display shows of some values; negative ones are black.
static inline void NAME(shown)(const NAME(Samples) *samples, const REAL *values, int64_t some, REAL *shown) {
    const REAL darkest = samples->darkest, power = samples->power;
    if (power == 0)
        for (int64_t i = 0; i < some; i++) shown[i] = values[i];
    else
        for (int64_t i = 0; i < some; i++) shown[i] = NAME(power)(NAME(above)(values[i], 0) + darkest, power);
}

// Return the misfit of one sample of some texels; `above` [3] gets its gradient in their value, `of_ambient` that of the ambient, if not NULL.
static double NAME(misfit)(
    const NAME(Look) *look, const NAME(Samples) *samples, int64_t number, int64_t first, int64_t some, const NAME(Seen) *seen,
    REAL above[3][BLOCK], REAL *of_ambient
) {
    const int64_t texels = look->texels, row = samples->rows[number];
    const uint8_t *flags = samples->flags + row * texels + first;
    const REAL *lit = samples->lit ? samples->lit + samples->lit_rows[number] * texels + first : 0;
    REAL weight[BLOCK], squares[BLOCK], found[BLOCK], shown[BLOCK], target[BLOCK];
    const REAL darkest = samples->darkest, power = samples->power;
    for (int64_t i = 0; i < some; i++) weight[i] = samples->weights[flags[i]], squares[i] = 0;
    for (int c = 0; c < 3; c++) {
        const REAL *own = look->diffuse + c * texels + first, *pixels = samples->pixels + (3 * row + c) * texels + first;
        const REAL *mask = look->mask ? look->mask + (look->mask_channels == 3 ? c : 0) * texels + first : 0;
        const REAL *ambient = samples->ambient ? samples->ambient + c * texels + first : 0;
        for (int64_t i = 0; i < some; i++)
            found[i] = seen->colour[c][i] * seen->reflected[i] * seen->share[i] * (mask ? mask[i] : 1) + own[i] * seen->n_dot_l[i];
        if (lit)
            for (int64_t i = 0; i < some; i++) found[i] *= lit[i];
        if (ambient)
            for (int64_t i = 0; i < some; i++) found[i] += ambient[i];
        NAME(shown)(samples, found, some, shown);
        NAME(shown)(samples, pixels, some, target);
        for (int64_t i = 0; i < some; i++) {
            const REAL residual = shown[i] - target[i];
            squares[i] += weight[i] * residual * residual;
            above[c][i] = 2 * weight[i] * residual;
        }
        if (power != 0)  // with the slope of what is shown
            for (int64_t i = 0; i < some; i++) above[c][i] *= found[i] < 0 ? 0 : power * shown[i] / (found[i] + darkest);
        if (of_ambient)
            for (int64_t i = 0; i < some; i++) of_ambient[c * texels + first + i] += above[c][i];
        if (lit)
            for (int64_t i = 0; i < some; i++) above[c][i] *= lit[i];
    }
    double total = 0;
    for (int64_t i = 0; i < some; i++) total += squares[i];
    return total;
}

// The misfit, a share a strip, and where `gradients` is not 0 what `distribution_gradients` gives for it, and `of_ambient`.
void NAME(distribution_misfit)(
    LOOK_OF, const REAL *pixels, const uint8_t *flags, const int64_t *rows, const REAL *weights, const REAL *lit, const int64_t *lit_rows,
    const REAL *ambient, double darkest, double power, double *of_strips, int64_t gradients, GRADIENTS_OF,
    REAL *of_ambient, int64_t threads
) {
    const NAME(Look) look = LOOK_HERE;
    const NAME(Samples) samples = {pixels, lit, ambient, weights, flags, rows, lit_rows, (REAL)darkest, (REAL)power};
    const int64_t parts = (texels + BLOCK - 1) / BLOCK, entries = 4 * lobes * (size + 1) * (size + 1);
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t strip = 0; strip < STRIPS; strip++) {
        const NAME(Sums) sums = GRADIENTS_HERE;
        NAME(Seen) seen;
        REAL above[3][BLOCK];
        double total = 0;
        const int64_t from = parts * strip / STRIPS * BLOCK, to = parts * (strip + 1) / STRIPS * BLOCK, own = (to < texels ? to : texels) - from;
        if (gradients) NAME(nothing_yet)(&look, &sums, count, from, own);
        if (gradients && of_ambient)
            for (int c = 0; c < 3; c++) memset(of_ambient + c * texels + from, 0, own * sizeof(REAL));
        for (int64_t part = parts * strip / STRIPS; part < parts * (strip + 1) / STRIPS; part++) {
            const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
            for (int64_t number = 0; number < count; number++) {
                NAME(see)(&look, number, first, some, &seen);
                NAME(colours)(&look, first, some, &seen);
                total += NAME(misfit)(&look, &samples, number, first, some, &seen, above, gradients ? of_ambient : 0);
                if (gradients) NAME(pull)(&look, &sums, number, first, some, &seen, above[0], BLOCK);
            }
        }
        of_strips[strip] = total;
    }
    if (!gradients) return;
    GRADIENTS_DONE
}
