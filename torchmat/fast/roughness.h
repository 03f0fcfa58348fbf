// How rough planes are: the sum over neighbours, across and down, of sqrt(difference^2 + small^2) - small, and the gradient of that.

// Return the roughness between two rows, and its slope for each difference.
static double NAME(rough)(const REAL *one, const REAL *other, int64_t count, REAL small, REAL *slope) {
    double total = 0;
    for (int64_t i = 0; i < count; i++) {
        const REAL apart = other[i] - one[i], size = SQRT(apart * apart + small * small);
        slope[i] = apart / size;
        total += size - small;
    }
    return total;
}

// The roughness of `planes` of rows x columns; `slopes` is room for a row.
void NAME(roughness)(
    const REAL *given, int64_t planes, int64_t rows, int64_t columns, double small, double *found, REAL *of, REAL *slopes, int64_t threads
) {
    double total = 0;
    memset(of, 0, planes * rows * columns * sizeof(REAL));
    for (int64_t row = 0; row < planes * rows; row++) {
        const REAL *here = given + row * columns;
        REAL *to = of + row * columns;
        total += NAME(rough)(here, here + 1, columns - 1, (REAL)small, slopes);
        for (int64_t i = 0; i < columns - 1; i++) to[i] -= slopes[i];
        for (int64_t i = 0; i < columns - 1; i++) to[i + 1] += slopes[i];
        if (row % rows == rows - 1) continue;
        total += NAME(rough)(here, here + columns, columns, (REAL)small, slopes);
        for (int64_t i = 0; i < columns; i++) to[i] -= slopes[i];
        for (int64_t i = 0; i < columns; i++) to[columns + i] += slopes[i];
    }
    *found = total;
    (void)threads;
}
