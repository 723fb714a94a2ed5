#include "band_edge.h"

#include <string.h>

void draw_in(const Margins *margins, double bands[])
{
    for (size_t k = 0; k < margins->samples; ++k) {
        for (size_t i = 0; i < margins->bands; ++i) {
            double *const band = bands + 2 * (k * margins->bands + i);
            const double half = (band[1] - band[0]) / 2.0;
            const double inside = margins->margin[i] < half ? margins->margin[i] : half;
            band[0] += inside;
            band[1] -= inside;
        }
    }
}

Sample follow_edge(const Edge *edge, const double bands[], const Sample *sample, double line[])
{
    const size_t p = edge->p, ahead = edge->samples - 1;
    memcpy(line, sample->setpoint, p * sizeof(double));
    memcpy(line + p, sample->reference, ahead * p * sizeof(double));
    for (size_t k = 0; k < edge->samples; ++k) {
        for (size_t i = 0; i < edge->bands; ++i)
            line[k * p + edge->outputs[i]] = bands[2 * (k * edge->bands + i) + edge->end];
    }
    return (Sample){sample->y, sample->measured, line + p, line, sample->applied};
}
