/* Adaptive generalised predictive control: gpc.py and models/recursive.py. */
#ifndef GPC_H
#define GPC_H

#include "change_limits.h"
#include "linearised_prediction.h"
#include "sample.h"

typedef struct {
    const LinearisedPrediction *prediction;
    size_t n_d, ahead;     /* known disturbances; for how many samples to come each is forecast: N, or 0 */
    double filtered;       /* c of the observer polynomial T = 1 - c/q */
    double forgetting, largest_trace, dead_zone;
    const double *roots;   /* p: of the weights Q */
    const double *ridge;   /* Nu m: Lambda */
    const ChangeLimits *limits;
} GPC;

/* There are w = p Ly + m Lu + n_d (Lu + 1) coefficients for each output. */
typedef struct {
    double *u;          /* m */
    double *begun;      /* whether `y` and `d` are known */
    double *missing;    /* how many samples to come teach nothing, as phi is not known */
    double *y, *d;      /* p, n_d */
    double *changes;    /* p Ly of the outputs, m Lu of the inputs, newest first */
    double *dd;         /* (Lu + 1) n_d of the disturbances, newest first */
    double *regressor;  /* w: phi, filtered by 1/T */
    double *target;     /* p: the latest change of the outputs, filtered too */
    double *residual;   /* p: what the estimates leave unexplained of it */
    double *theta;      /* p x w */
    double *root;       /* w x w: S of the covariance S S' */
    /* of this step only */
    double *seen, *gain; /* w each: S' phi; how much of an error the estimates take */
    double *learned;     /* w x w: the next S */
    double *course;      /* (1 + ahead) x n_d: disturbances now, and their forecasts */
    double *acting;      /* N p: what else changes the outputs */
    PredictionMemory prediction;
    ChangeLimitsMemory limits;
} GPCMemory;

void gpc_step(const GPC *gpc, const GPCMemory *held, const Sample *sample, double u[], Told *told);

#endif
