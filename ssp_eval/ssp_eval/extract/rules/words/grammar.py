"""The words of grammar and discourse that the rules know, as data.

They say what is denied, imagined, past, quoted, planned, revised or important.
"""

from __future__ import annotations

from ssp_eval.extract.rules.hits import Kind
from ssp_eval.extract.rules.words.notation import Table, phrases

KINDS: dict[Kind, Table] = {
    Kind.PRONOUN: {
        "it": phrases("it, its"),
        "they": phrases("they, them, their"),
        "he": phrases("he, she, him, her, his, hers"),
        "rider": phrases("rider, riders"),
    },
    Kind.RELATIVE: {
        "who": phrases("who, which, that, whose, whom"),
    },
    Kind.NOT: {
        "no": phrases("no, none, neither, without any, nor"),
        "not": phrases("not, never, hardly"),
    },
    Kind.NO_LONGER: {
        "": phrases("no longer, not anymore, not any more, no more, not any longer"),
    },
    Kind.MODAL: {
        "may": phrases(
            """
            may, might, could, can, would, i'd, possibly, potentially, perhaps, maybe,
            chance that, possibility that,
            likely, probably, may be, might be, could be, seems, appears, seem,
            appear, probable, possible
            """
        ),
        "will": phrases("will, going to, gonna, shall, by then, by that time, by that point"),
        "must": phrases("should, must, need to, needs to, have to, has to, ought to"),
    },
    Kind.CONDITION: {
        "if": phrases(
            """
            if, in the event, unless, when, whenever, once, assuming, suppose, supposing,
            should an, should any, should he, should she, should one of, should anybody,
            should anyone, should somebody, should someone, should another, should that,
            should this, should traffic, provided, as soon as, as long as, should the, should it,
            should a, should they, whether, were to, in the case of, hypothetically
            """
        ),
        "case": phrases("in case, just in case"),
        "else": phrases("otherwise, or else"),
        "after": phrases("after, following which"),
        "until": phrases("until, till, before, by the time"),
        "needed": phrases(
            """
            if necessary, if needed, if required, when necessary, when needed, as
            needed, as necessary, if possible, where necessary, as required, if it is
            safe, when safe, if safe, when it is safe, where possible, if appropriate
            """
        ),
    },
    Kind.AUX: {
        "is": phrases("is, are, am"),
        "be": phrases("be, being, been, remains, remain, looks"),
        "have": phrases("has, have, having"),
        "past": phrases("was, were, had, did, used to"),
    },
    Kind.HISTORY: {
        "": phrases(
            """
            previously, earlier, ago, formerly, in the past, moments before, a moment
            ago, ego history, observed history, historical, so far, last time
            """
        ),
    },
    Kind.READY: {
        "": phrases(
            """
            inclined to, tempted to, prepare to, preparing to, prepared to, ready to, be ready
            for, prepare for, preparing for, about to, trying to, tries to, try to, wishing to,
            signaling to, signalling to, in a position to, appears to, seems to, ready for,
            attempting to, looking to, able to, allowed to, preparing, signaling, signalling,
            signals, indicating, poised to, set to, due to turn, has the option to, reserve,
            allow, allowing, allows, let, letting, lets, enable, enabling, hoping to, prepares to,
            consider, considering, considered

            """
        ),
        # Of the ego this is a plan; of anybody else it hasn't happened.
        "intend": phrases(
            """
            likely to, expected to, intends to, intend to, wants to, want to, wanna, planning to,
            intending to, wanting to, intention to, plans to, plan to, aims to, aim to, intention
            is to, plan is to, decides to, decide to, opts to, opt to, chooses to, choose to,
            intent is to, goal is to, aiming to, intended to, elects to, decided to, has decided
            to, have decided to, choosing to

            """
        ),
    },
    Kind.REJECT: {
        # Also of the item before it: lane change to the left, rejected.
        "item": phrases("rejected, reject, rejecting, ruled out, rule out, discard"),
        "": phrases(
            """
            instead of, rather than, without, avoid, avoids, avoiding, no need to, no need for, not
            need to, no reason to, unnecessary to, not necessary to, unsafe to, refrain from,
            refraining from, against, it would be, opposed to, as opposed to, cancel, cancelling,
            canceling, abort, aborting, abandon, abandoning, postpone, postponing, call off, hold
            off, not have to, not required to, too risky to, not safe to, could also, alternative
            is, alternative would be, other option is, prevent, preventing, prevents, prevented
            """
        ),
        # Somebody does it to us: what follows is our own plan that he thwarts.
        "ours": tuple(
            f"{verb} {us} from"
            for verb in phrases(
                "keep, keeps, keeping, stop, stops, stopping, hold, holds, bar, bars"
            )
            for us in phrases("us, me, the ego, the ego vehicle, the ego car, our vehicle, our car")
        ),
    },
    Kind.REJECTED: {
        "": phrases(
            """
            unnecessary, is ruled out, are ruled out, is rejected, unsafe, too risky,
            not an option, not possible, impossible, is discarded, discarded,
            dismissed, too dangerous, was rejected, was discarded, out of the
            question, too late, excluded, prohibited, forbidden
            """
        ),
    },
    Kind.JOIN: {
        "and": phrases("and, plus, as well as"),
        "or": phrases("or"),
        "but": phrases("but, however, though, although, whereas, yet, still, nevertheless"),
        "so": phrases("so, therefore, thus, hence, consequently, accordingly, that way"),
        "because": phrases(
            """
            because, since, as, due to, because of, given, for, owing to, in response
            to, given that, so that
            """
        ),
        "while": phrases("while, whilst"),
        "by": phrases("by"),
        "now": phrases("by now, now, currently, for now, at present"),
    },
    Kind.HYPOTHETICAL: {
        "": phrases(
            """
            either, potential, any, imaginary, mistaken for, taken for, mistook for,
            took it for, believed it to be, confused with, looked like, resembles, hypothetical,
            imagine, what if, unseen, unexpected, invisible, watch for, watch out for,
            look out for, alert for, alert to, vigilant for, on the lookout for, lookout for,
            scan for, check for, beware of, watching for, scanning for, checking for, looking for,
            watching out for, looking out for, in search of
            """
        ),
    },
    Kind.FINAL: {
        "meta": phrases(
            "meta actions, meta action sequence, action sequence, meta driving actions"
        ),
        "": phrases(
            """
            final plan, final decision, final action, final answer, final driving
            plan, decision, final maneuver, final manoeuvre, in conclusion,
            conclusion, driving plan, chosen action, selected action, final intent,
            correct action, revised plan, updated plan, new plan, final output, to
            conclude, my decision, final choice, chosen plan
            """
        ),
    },
    Kind.THEN: {
        "": phrases(
            """
            then, after that, afterwards, afterward, later, next, subsequently,
            thereafter, eventually, later on, in the future, at the next, in a few
            seconds, soon, following that
            """
        ),
    },
    Kind.REVISE: {
        "": phrases(
            """
            revised, changed to, corrected to, actually, on second thought, on second thoughts,
            correction, scratch that, i change my mind, change of plan, instead, no wait, hold on,
            revising, i revise, we revise, let me revise, re evaluating, reconsidering
            """
        ),
    },
    Kind.QUOTE: {
        "": phrases(
            """
            prompt, question, instruction, instructions, asked, asks, user, option, example, the
            task is, task, hypothesis, alternative, system, user says, prev decision, previous
            decision, last decision, previous action, prev action, last action, previous plan,
            old plan, earlier plan, past action, previous output, previous answer, prev plan,
            former plan, earlier decision, prior decision, prior action, old decision, history
            """
        ),
        "off": phrases("unticked"),
        "on": phrases("ticked"),
        # Also a denial of what stands before.
        "not": phrases("not recommended, not advised, not chosen, not advisable, not selected"),
        "options": phrases(
            """
            options, alternatives, candidates, choices, candidate actions, possible actions,
            rejected options, discarded options, options considered, options were,
            considered options, alternatives considered, possibilities, rejected alternatives,
            two ways, three ways, discarded alternatives, ruled out options, other options,
            other possibilities, alternatives are, allowed actions, available actions,
            action space, options are, candidate maneuvers, candidate manoeuvres,
            what not to do, ideas, i considered, we considered, two options,
            maneuver rejected, manoeuvre rejected, rejected maneuver,
            rejected manoeuvre, rejected action, rejected actions, action rejected, rejected plan,
            plan rejected, decision rejected, rejected decision, three options, two possibilities,
            three possibilities, do not do
            """
        ),
    },
    Kind.PURPOSE: {
        "to": phrases("to, in order to, so as to"),
    },
}
