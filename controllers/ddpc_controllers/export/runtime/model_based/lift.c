#include "lift.h"

#include <math.h>

static double monomial(const size_t factors[], size_t degree, const double x[])
{
    double product = 1.0;
    for (size_t i = 0; i < degree; ++i) product *= x[factors[i]];
    return product;
}

static double squared_distance(const double centre[], size_t size, const double x[])
{
    double sum = 0.0;
    for (size_t i = 0; i < size; ++i) sum += (x[i] - centre[i]) * (x[i] - centre[i]);
    return sum;
}

static double thin_plate(double distance)
{
    return distance > 0.0 ? distance * log10(distance) : 0.0;
}

void lift(const Term *const terms[], size_t count, const double x[], double z[])
{
    for (size_t k = 0; k < count; ++k) {
        const Term *term = terms[k];
        for (size_t i = 0; i < term->count; ++i) {
            const size_t row = i * term->size;
            switch (term->kind) {
            case MONOMIALS: *z = monomial(term->factors + row, term->size, x); break;
            case THIN_PLATES: *z = thin_plate(sqrt(squared_distance(term->centres + row, term->size, x))); break;
            case GAUSSIANS: *z = exp(-squared_distance(term->centres + row, term->size, x) / term->spread); break;
            }
            ++z;
        }
    }
}
