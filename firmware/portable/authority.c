#include "authority.h"

static const float MOST_SESSIONS = 16777216.0f; /* what a float of 32 bits holds of whole numbers */

static bool same(const sender *a, const sender *b) {
    return a->system == b->system && a->component == b->component && a->link == b->link && a->session == b->session;
}

uint32_t authority_session(float parameter) {
    return parameter >= 1.0f && parameter < MOST_SESSIONS ? (uint32_t)parameter : 0u;
}

bool authority_allows(const authority *a, const sender *s) {
    return !a->armed || !a->owned || s->session == 0u || same(s, &a->owner);
}

void authority_arm(authority *a, const sender *s) {
    if (s->session != 0u) {
        a->owner = *s;
        a->owned = true;
    } else if (!a->armed) {
        a->owned = false;
    }
    a->armed = true;
}

void authority_hand_over(authority *a, const sender *s) {
    if (!a->armed) return;
    a->owner = *s;
    a->owned = true;
}

bool authority_admits(authority *a, const sender *s) {
    if (!a->armed) return true;
    if (!a->owned && s->system == a->system) authority_hand_over(a, s);
    bool good = a->owned && same(s, &a->owner);
    a->foreign += !good;
    return good;
}

void authority_end(authority *a) { a->armed = a->owned = false; }
