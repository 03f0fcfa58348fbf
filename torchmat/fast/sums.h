// The value of the models whose maps weigh known functions of light and view, and of Lambert's, texel by texel in one pass.

enum { COSINE, POLYNOMIAL, HALF, HALF_LIGHT, QUADRATIC, HARMONIC };  // as in sums.py
enum { MOST_TERMS = 16, MOST_BANDS = 4 };

// Hemispherical harmonics, as models/bases.py has them: `scales` of each degree and order.
APART void NAME(harmonics)(
    const REAL *light[3], const REAL *scales, int64_t bands, int64_t some, REAL weight[MOST_TERMS][BLOCK]
) {
    REAL shrink[BLOCK], cosine[BLOCK], sine[BLOCK], value[BLOCK], previous[BLOCK];
    for (int64_t i = 0; i < some; i++) {
        const REAL squared = NAME(ratio)(light[2][i], 1 + light[2][i]);
        shrink[i] = squared <= 0 ? 0 : 2 * SQRT(squared);
        cosine[i] = 1, sine[i] = 0;
    }
    REAL first = 1;  // 1 3 5 ... (2 order - 1)
    for (int64_t order = 0; order < bands; order++) {
        for (int64_t i = 0; i < some; i++) value[i] = first, previous[i] = 0;
        for (int64_t degree = order; degree < bands; degree++) {
            const REAL ahead = (REAL)(2 * degree - 1), behind = (REAL)(degree + order - 1);
            const REAL over = 1 / (REAL)(degree > order ? degree - order : 1);
            if (degree > order)
                for (int64_t i = 0; i < some; i++) {
                    const REAL next = (ahead * (2 * light[2][i] - 1) * value[i] - behind * previous[i]) * over;
                    previous[i] = value[i], value[i] = next;
                }
            const REAL scale = scales[degree * MOST_BANDS + order];
            REAL *right = weight[degree * degree + degree + order], *left = weight[degree * degree + degree - order];
            for (int64_t i = 0; i < some; i++) left[i] = scale * value[i] * sine[i];
            for (int64_t i = 0; i < some; i++) right[i] = scale * value[i] * cosine[i];
        }
        for (int64_t i = 0; i < some; i++) {
            const REAL c = light[0][i] * shrink[i], s = light[1][i] * shrink[i], turned = cosine[i] * c - sine[i] * s;
            sine[i] = sine[i] * c + cosine[i] * s, cosine[i] = turned;
        }
        first *= (REAL)(2 * order + 1);
    }
}

// The sum over terms of weights times layers [terms, channels, texels], of which a block is taken.
APART void NAME(combine)(
    REAL weight[][BLOCK], const REAL *layers, int64_t terms, int64_t channels, int64_t texels, int64_t some, REAL total[3][BLOCK]
) {
    for (int64_t c = 0; c < channels; c++) {
        const REAL *from = layers + c * texels;
        for (int64_t i = 0; i < some; i++) total[c][i] = weight[0][i] * from[i];
        for (int64_t k = 1; k < terms; k++) {
            from += channels * texels;
            for (int64_t i = 0; i < some; i++) total[c][i] += weight[k][i] * from[i];
        }
    }
}

// The functions of a basis, [terms] planes; `half` where one of its kind wants it.
APART void NAME(weights)(
    int64_t basis, int64_t terms, const REAL *scales, const REAL *light[3], const REAL *view[3], REAL half[3][BLOCK], int64_t some,
    REAL weight[MOST_TERMS][BLOCK]
) {
    if (basis == HARMONIC) NAME(harmonics)(light, scales, terms == 4 ? 2 : terms == 9 ? 3 : 4, some, weight);
    if (basis == COSINE) memcpy(weight[0], light[2], some * sizeof(REAL));
    if (basis == POLYNOMIAL)
        for (int64_t i = 0; i < some; i++) {
            const REAL x = light[0][i], y = light[1][i];
            weight[0][i] = x * x, weight[1][i] = y * y, weight[2][i] = x * y, weight[3][i] = x, weight[4][i] = y, weight[5][i] = 1;
        }
    if (basis == HALF || basis == HALF_LIGHT)
        for (int axis = 0; axis < 3; axis++) memcpy(weight[axis], half[axis], some * sizeof(REAL));
    if (basis == HALF_LIGHT) {
        for (int axis = 0; axis < 3; axis++) memcpy(weight[3 + axis], light[axis], some * sizeof(REAL));
        for (int64_t i = 0; i < some; i++) weight[6][i] = 1;
    }
    if (basis == QUADRATIC) {
        const REAL *linear[4] = {light[0], light[1], view[0], view[1]};
        for (int64_t i = 0; i < some; i++) weight[0][i] = 1;
        for (int a = 0, at = 5; a < 4; a++) {
            memcpy(weight[1 + a], linear[a], some * sizeof(REAL));
            for (int b = a; b < 4; b++, at++)
                for (int64_t i = 0; i < some; i++) weight[at][i] = linear[a][i] * linear[b][i];
        }
    }
}

// Add k_d (N.L) + k_s (N.H)^n of seven parameters, the last of which is log n, to the colours of a block.
APART void NAME(add_phong)(
    const REAL *lobe, const REAL *n_dot_l, const REAL *n_dot_h, int64_t some, REAL total[3][BLOCK]
) {
    const REAL exponent = NAME(exponential)(lobe[6]);
    REAL shine[BLOCK];
    for (int64_t i = 0; i < some; i++) shine[i] = NAME(power)(n_dot_h[i], exponent);
    for (int c = 0; c < 3; c++)
        for (int64_t i = 0; i < some; i++) total[c][i] += lobe[c] * n_dot_l[i] + lobe[3 + c] * shine[i];
}

// Turn codes of a screen into linear light, those below 0 into black (IEC 61966-2-1).
APART void NAME(decode)(REAL *value, int64_t some) {
    for (int64_t i = 0; i < some; i++) {
        const REAL code = NAME(above)(value[i], 0);
        const REAL curve = NAME(power)((code + (REAL)0.055) / (REAL)1.055, (REAL)2.4);
        value[i] = code > (REAL)0.04045 ? curve : code / (REAL)12.92;
    }
}

// The value [count, 3, texels] of layers [terms, channels, texels]: one channel is that of a chroma [3, texels]. `lobe` [7] may be NULL.
void NAME(weighed)(
    const REAL *light, const REAL *view, const REAL *layers, const REAL *chroma, const REAL *lobe, REAL *out, int64_t lights,
    int64_t light_places, int64_t views, int64_t view_places, int64_t count, int64_t texels, int64_t basis, int64_t terms, int64_t codes,
    int64_t threads
) {
    const NAME(Directions) lit = {light, lights, light_places}, seen = {view, views, view_places};
    const int64_t channels = chroma ? 1 : 3;
    REAL scales[MOST_BANDS * MOST_BANDS];
    for (int degree = 0; degree < MOST_BANDS; degree++)
        for (int order = 0; order <= degree; order++) {
            double product = 1;  // of degree - order + 1 ... degree + order
            for (int k = degree - order + 1; k <= degree + order; k++) product *= k;
            scales[degree * MOST_BANDS + order] = (REAL)sqrt((2 * degree + 1) * (order ? 2 : 1) / (2 * M_PI * product));
        }
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (texels + BLOCK - 1) / BLOCK; part++) {
        const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
        REAL light_room[3][BLOCK], view_room[3][BLOCK], half[3][BLOCK], weight[MOST_TERMS][BLOCK], total[3][BLOCK];
        for (int64_t number = 0; number < count; number++) {
            const REAL *l[3], *v[3];
            NAME(along)(&lit, number, first, some, light_room, l);
            NAME(along)(&seen, number, first, some, view_room, v);
            if (lobe || basis == HALF || basis == HALF_LIGHT) {
                for (int axis = 0; axis < 3; axis++)
                    for (int64_t i = 0; i < some; i++) half[axis][i] = l[axis][i] + v[axis][i];
                NAME(normalised)(half[0], half[1], half[2], some, half);
            }
            NAME(weights)(basis, terms, scales, l, v, half, some, weight);
            NAME(combine)(weight, layers + first, terms, channels, texels, some, total);
            if (chroma)
                for (int c = 2; c >= 0; c--)
                    for (int64_t i = 0; i < some; i++) total[c][i] = total[0][i] * chroma[c * texels + first + i];
            if (lobe) NAME(add_phong)(lobe, l[2], half[2], some, total);
            for (int c = 0; c < 3; c++) {
                if (codes) NAME(decode)(total[c], some);
                NAME(show)(total[c], l[2], v[2], some, out + (3 * number + c) * texels + first);
            }
        }
    }
}

// The value [count, 3, texels] of an albedo [3, texels] and normals [3, texels] of any length.
void NAME(lambert)(
    const REAL *light, const REAL *view, const REAL *albedo, const REAL *normal, REAL *out, int64_t lights, int64_t light_places,
    int64_t views, int64_t view_places, int64_t count, int64_t texels, int64_t threads
) {
    const NAME(Directions) lit = {light, lights, light_places}, seen = {view, views, view_places};
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (texels + BLOCK - 1) / BLOCK; part++) {
        const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
        REAL light_room[3][BLOCK], view_room[3][BLOCK], unit[3][BLOCK], cosine[BLOCK], value[BLOCK];
        NAME(normalised)(normal + first, normal + texels + first, normal + 2 * texels + first, some, unit);
        for (int64_t number = 0; number < count; number++) {
            const REAL *l[3], *v[3];
            NAME(along)(&lit, number, first, some, light_room, l);
            NAME(along)(&seen, number, first, some, view_room, v);
            for (int64_t i = 0; i < some; i++)
                cosine[i] = NAME(above)(l[0][i] * unit[0][i] + l[1][i] * unit[1][i] + l[2][i] * unit[2][i], 0);
            for (int c = 0; c < 3; c++) {
                const REAL *own = albedo + c * texels + first;
                for (int64_t i = 0; i < some; i++) value[i] = own[i] * cosine[i];
                NAME(show)(value, l[2], v[2], some, out + (3 * number + c) * texels + first);
            }
        }
    }
}
