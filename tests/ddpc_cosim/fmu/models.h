/* Models with every kind of event, behind the front ends of three FMI versions.
   The text that an instance is created with (GUID or token) says which model it is. */
#ifndef MODELS_H
#define MODELS_H

#include <stddef.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Value references. */
enum { U = 0, X = 1, V = 2, GRAVITY = 3, RESTITUTION = 4, COUNT = 5, RATE = 6, DX = 7, DV = 8, NAME_LENGTH = 9,
       VALUES = 16 };

typedef enum { LAG, BALL, STAIR, RELAY } Kind;

typedef struct {
    Kind kind;
    double time, stop;
    double values[VALUES];
    double next_event; /* negative: none */
    int terminate;
} Model;

Model *create(const char *kind);
size_t states(const Model *m);
size_t indicators(const Model *m);
void initialise(Model *m);
void derivatives(Model *m, double dx[]);
void event_indicators(const Model *m, double z[]);
int handle_event(Model *m);         /* whether the states have jumped */
int completed_step(const Model *m); /* whether an event is wanted */
int step(Model *m, double h);       /* Co-Simulation, LAG and STAIR only; an FMI status */
int is_writable(unsigned reference);

#endif
