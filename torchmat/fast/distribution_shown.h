// The distribution material's value as it is shown, without gradients, where texels have directions of their own.

// Turn the directions of a block into the texels' frames.
static inline void NAME(turned_each)(const NAME(Look) *look, const REAL *direction[3], int64_t first, int64_t some, REAL to[3][BLOCK]) {
    for (int axis = 0; axis < 3; axis++) {
        if (!look->frame) {
            memcpy(to[axis], direction[axis], some * sizeof(REAL));
            continue;
        }
        const REAL *x = look->frame + axis * look->texels + first, *y = x + 3 * look->texels, *z = y + 3 * look->texels;
        for (int64_t i = 0; i < some; i++) to[axis][i] = direction[0][i] * x[i] + direction[1][i] * y[i] + direction[2][i] * z[i];
    }
}

// Half vectors, and pi times what is reflected along them by Fresnel's rise of this exponent.
APART void NAME(halve)(
    const NAME(Look) *look, REAL exponent, const REAL *light[3], const REAL *view[3], int64_t first, int64_t some, REAL half[3][BLOCK],
    REAL *reflected
) {
    REAL grazing[BLOCK];
    for (int64_t i = 0; i < some; i++) {
        const REAL x = light[0][i] + view[0][i], y = light[1][i] + view[1][i], z = light[2][i] + view[2][i];
        const REAL length = SQRT(NAME(above)(x * x + y * y + z * z, (REAL)1e-24)), shrink = 1 / length;
        half[0][i] = x * shrink, half[1][i] = y * shrink, half[2][i] = z * shrink;
        grazing[i] = NAME(above)(1 - length / 2, 0), reflected[i] = (REAL)M_PI;
    }
    if (look->fresnel)
        for (int64_t i = 0; i < some; i++) {
            const REAL fresnel = look->fresnel[first + i];
            reflected[i] *= fresnel + (1 - fresnel) * NAME(power)(grazing[i], exponent);
        }
}

// The value [count, 3, texels]; maps as in `Look`.
void NAME(distribution_shown)(
    const REAL *light, const REAL *view, const REAL *frame, const REAL *diffuse, const REAL *mask, const REAL *fresnel, const REAL *index,
    const REAL *table, const REAL *squares, REAL *out, double exponent, int64_t lights, int64_t light_places, int64_t views,
    int64_t view_places, int64_t count, int64_t texels, int64_t size, int64_t lobes, int64_t mask_channels, int64_t dense, int64_t threads
) {
    const NAME(Directions) lit = {light, lights, light_places}, looking = {view, views, view_places};
    const NAME(Look) look = {
        0, 0, 0, 0, frame, diffuse, mask, fresnel, index, table, squares[0], squares[1], texels, size, lobes, mask_channels, dense,
    };
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (texels + BLOCK - 1) / BLOCK; part++) {
        const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
        REAL light_room[3][BLOCK], view_room[3][BLOCK], half[3][BLOCK], value[BLOCK];
        const REAL *halves[3] = {half[0], half[1], half[2]};
        NAME(Seen) seen;
        for (int64_t number = 0; number < count; number++) {
            const REAL *l[3], *v[3];
            NAME(along)(&lit, number, first, some, light_room, l);
            NAME(along)(&looking, number, first, some, view_room, v);
            NAME(halve)(&look, (REAL)exponent, l, v, first, some, half, seen.reflected);
            NAME(turned_each)(&look, l, first, some, seen.light);
            NAME(turned_each)(&look, v, first, some, seen.view);
            NAME(turned_each)(&look, halves, first, some, seen.half);
            NAME(measure)(&look, some, &seen);
            NAME(colours)(&look, first, some, &seen);
            for (int c = 0; c < 3; c++) {
                NAME(channel)(&look, c, first, some, &seen, value);
                NAME(show)(value, l[2], v[2], some, out + (3 * number + c) * texels + first);
            }
        }
    }
}
